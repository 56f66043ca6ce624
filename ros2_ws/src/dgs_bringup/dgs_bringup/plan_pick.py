"""Asks for grasps in the newest cloud and has the arm plan one without moving: the look before the first motion.

    ros2 run dgs_bringup plan_pick                  # prediction and plan
    ros2 run dgs_bringup plan_pick --predict-only   # prediction: all that a replayed bag can give

Exit code 0: done; 1: no grasp, or none that the arm can execute; 2: bad arguments; 3: a node is missing or silent.
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated

import typer
from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.srv import PredictGrasps

from dgs_bringup.ros_session import RosSession, wait_until
from dgs_description.errors import ErrorCode
from dgs_description.words import plural

_SHOWN = 5


def predicted(session: RosSession, max_grasps: int, seed: int) -> PredictGrasps.Response:
    """The answer of /predict_grasps for the newest cloud, once there is one. Raises TimeoutError."""
    request = PredictGrasps.Request(max_grasps=max_grasps, seed=seed)
    answers: list[PredictGrasps.Response] = []

    def answered() -> bool:
        answers.append(session.call(PredictGrasps, "/predict_grasps", request))
        return bool(answers[-1].error_code != ErrorCode.NO_CLOUD_YET)

    if not wait_until(answered, session.appear, period=0.5):
        raise TimeoutError(answers[-1].message)
    return answers[-1]


def planned(session: RosSession, answer: PredictGrasps.Response) -> ExecuteGrasp.Result:
    """The answer of /execute_grasp, told to plan only. Raises TimeoutError."""
    goal = ExecuteGrasp.Goal(header=answer.header, grasps=answer.grasps, plan_only=True)
    handle = session.send(ExecuteGrasp, "/execute_grasp", goal)
    return session.wait(handle.get_result_async(), what="/execute_grasp").result


def describe_prediction(answer: PredictGrasps.Response) -> list[str]:
    """Lines about the grasps, in the order in which to try them."""
    count, frame = plural(len(answer.grasps), "grasp"), answer.header.frame_id
    lines = [f"{count} in {frame} from {answer.points_used} points ({answer.model_id})"]
    for number, grasp in enumerate(answer.grasps[:_SHOWN]):
        p = grasp.tcp_pose.position
        place = f"TCP at ({p.x:.3f}, {p.y:.3f}, {p.z:.3f}) m"
        lines.append(f"  {number}: score {grasp.score:.2f}, {place}, by {grasp.source}")
    if answer.error_code:
        lines.append(f"/predict_grasps: {answer.error_code} {answer.message}")
    return lines


def describe_plan(result: ExecuteGrasp.Result) -> list[str]:
    """Lines about the plan and why candidates were refused."""
    refused = Counter(ErrorCode(r.code).name for r in result.rejections)
    lines = [f"  refused: {count} {name}" for name, count in refused.most_common()]
    lines += [f"    {r.index}: {r.reason}" for r in result.rejections[:_SHOWN]]
    return [*lines, f"/execute_grasp: {result.error_code} {result.message}"]


def plan_pick(
    predict_only: Annotated[bool, typer.Option("--predict-only", help="Leave the arm alone.")] = False,
    max_grasps: Annotated[int, typer.Option(min=1, max=256, help="Candidates.")] = 32,
    seed: Annotated[int, typer.Option(min=0, max=2**64 - 1, help="Same seed and cloud, same grasps.")] = 0,
) -> None:
    """Ask for grasps in the newest cloud and have the arm plan one without moving."""
    try:
        with RosSession("plan_pick") as session:
            answer = predicted(session, max_grasps, seed)
            typer.echo("\n".join(describe_prediction(answer)))
            code = answer.error_code
            if not code and not predict_only:
                result = planned(session, answer)
                typer.echo("\n".join(describe_plan(result)))
                code = result.error_code
    except TimeoutError as error:
        typer.echo(f"plan_pick: {error}", err=True)
        raise typer.Exit(3) from error
    raise typer.Exit(int(code != 0))


def main() -> None:
    """Entry point of the executable `plan_pick`."""
    typer.run(plan_pick)
