"""Asks for grasps in the newest cloud and has the arm plan one without moving: the look before the first motion.

    ros2 run dgs_bringup plan_pick                  # prediction and plan
    ros2 run dgs_bringup plan_pick --predict-only   # prediction: all that a replayed bag can give

Exit code 0: done; 1: no grasp, or none that the arm can execute; 2: bad arguments; 3: a node is missing or silent.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence

from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.srv import PredictGrasps

from dgs_bringup.ros_session import RosSession, wait_until
from dgs_description.errors import ErrorCode
from dgs_ros.base_node import SafeActionClient

_APPEAR, _ANSWER = 10.0, 120.0
"""Wait for a server, and for its answer [s]."""
_SHOWN = 5


def predicted(session: RosSession, max_grasps: int, seed: int) -> PredictGrasps.Response:
    """The answer of /predict_grasps for the newest cloud, once there is one. Raises TimeoutError."""
    client = session.node.create_client(PredictGrasps, "/predict_grasps")
    if not wait_until(client.service_is_ready, _APPEAR):
        raise TimeoutError("nobody serves /predict_grasps: start grasp_planner_node")
    request = PredictGrasps.Request(max_grasps=max_grasps, seed=seed)
    answers: list[PredictGrasps.Response] = []

    def answered() -> bool:
        answers.append(session.wait(client.call_async(request), _ANSWER, "/predict_grasps"))
        return bool(answers[-1].error_code != ErrorCode.NO_CLOUD_YET)

    wait_until(answered, _APPEAR, period=0.5)
    return answers[-1]


def planned(session: RosSession, answer: PredictGrasps.Response) -> ExecuteGrasp.Result:
    """The answer of /execute_grasp, told to plan only. Raises TimeoutError."""
    client = SafeActionClient(session.node, ExecuteGrasp, "/execute_grasp")
    if not wait_until(client.server_is_ready, _APPEAR):
        raise TimeoutError("nobody serves /execute_grasp: start arm_executor_node")
    goal = ExecuteGrasp.Goal(header=answer.header, grasps=answer.grasps, plan_only=True)
    handle = session.wait(client.send_goal_async(goal), _ANSWER, "/execute_grasp")
    if not handle.accepted:
        raise TimeoutError("/execute_grasp refused the goal; its log says why")
    return session.wait(handle.get_result_async(), _ANSWER, "/execute_grasp").result


def describe_prediction(answer: PredictGrasps.Response) -> list[str]:
    """Lines about the grasps, best first."""
    lines = [
        f"{len(answer.grasps)} grasps in {answer.header.frame_id} from {answer.points_used} points "
        f"({answer.model_id})"
    ]
    for number, grasp in enumerate(answer.grasps[:_SHOWN]):
        p = grasp.tcp_pose.position
        lines.append(
            f"  {number}: score {grasp.score:.2f}, TCP at ({p.x:.3f}, {p.y:.3f}, {p.z:.3f}) m, by {grasp.source}"
        )
    if answer.error_code:
        lines.append(f"/predict_grasps: {answer.error_code} {answer.message}")
    return lines


def describe_plan(result: ExecuteGrasp.Result) -> list[str]:
    """Lines about the plan and why candidates were refused."""
    refused = Counter(ErrorCode(r.code).name for r in result.rejections)
    lines = [f"  refused: {count} {name}" for name, count in refused.most_common()]
    return [*lines, f"/execute_grasp: {result.error_code} {result.message}"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Ask, print, and end with an exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--predict-only", action="store_true", help="leave the arm alone")
    parser.add_argument("--max-grasps", type=int, default=32, help="candidates (default 32)")
    parser.add_argument("--seed", type=int, default=0, help="the same seed and cloud give the same grasps")
    given = parser.parse_args(arguments)
    if given.max_grasps < 1 or given.seed < 0:
        parser.error("--max-grasps must be at least 1 and --seed not negative")
    try:
        with RosSession("plan_pick") as session:
            answer = predicted(session, given.max_grasps, given.seed)
            print("\n".join(describe_prediction(answer)), flush=True)
            if answer.error_code or given.predict_only:
                return int(answer.error_code != 0)
            result = planned(session, answer)
            print("\n".join(describe_plan(result)), flush=True)
            return int(result.error_code != 0)
    except TimeoutError as error:
        print(f"plan_pick: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
