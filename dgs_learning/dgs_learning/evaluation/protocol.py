"""The paper's clearing protocol (section VI) for a free hand: capture, plan, execute the best grasp, again."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.failed_grasps import FailedGrasps
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.scene import Planner, PlanRequest, Prediction
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.penetration import NO_PENETRATION, PenetrationMeter
from dgs_learning.evaluation.resting import resting_kind
from dgs_learning.evaluation.scene_world import Attempt, Outcome, SceneWorld
from dgs_learning.synthesis.scenes import Scene, make_scene
from dgs_learning.training.views import View, ViewSettings, capture
from dgs_sim_bridge.render.object_model import OPAQUE, ObjectModel

MAX_FAILURES = 3
"""After so many failed attempts an object is taken away (paper)."""
MAX_PUSHES = 3
"""An object that was pushed so often and is pushed again has not been lifted from the edge: it is taken away, too."""
EDGE = 0.05
"""The edge of the table, on the side of -x, stands so far outside of the workspace [m]."""
SEEN, SEEN_OVER_EDGE = 0.1, 0.2
"""The cloud is cut so far outside of the workspace: what sticks out over an edge is to be seen [m]."""
NO_GRASP = "no grasp found"
_NOTHING_SEEN = (
    ErrorCode.NO_OBJECTS,
    ErrorCode.NO_GRASP,
    ErrorCode.CLOUD_EMPTY,
    ErrorCode.CLOUD_NO_TABLE,
)


Truth = Callable[[], tuple[list[ObjectModel], list[Array]]]
"""Models and (4, 4) poses in the frame *table* of the objects that are left now: for planners that measure the harness
itself."""
PlannerFactory = Callable[[Truth], Planner]
"""Makes the planner of one scene; an ordinary planner ignores the truth."""


@dataclass(frozen=True)
class Setting:
    """One experiment.

    Attributes:
        scenes: number of scenes.
        objects_per_scene: smallest and largest number of objects.
        area: x and y extent of the workspace [m].
        seed: the same seed gives the same scenes, views and attempts.
        edge: the table is where x is larger [m], frame *table*, and the planner knows; None = everywhere.
    """

    scenes: int = 10
    objects_per_scene: tuple[int, int] = (10, 10)
    area: tuple[float, float] = (0.6, 0.6)
    seed: int = 0
    edge: float | None = None

    @property
    def seen(self) -> tuple[float, float]:
        """Half extents in x and y of what the cloud shows [m]."""
        return self.area[0] / 2 + (SEEN if self.edge is None else SEEN_OVER_EDGE), self.area[1] / 2 + SEEN

    def __post_init__(self) -> None:
        low, high = self.objects_per_scene
        if self.scenes < 1 or not 1 <= low <= high:
            raise ValueError(f"{self.scenes} scenes of {low} to {high} objects cannot be made")
        if min(self.area) < 0.2 or max(self.area) > 1.0:
            raise ValueError(f"the workspace must be 0.2 to 1 m wide, not {self.area[0]} x {self.area[1]} m")


@dataclass(frozen=True)
class AttemptRecord:
    """One attempt of one scene. Frame *table*; metres and radians where no unit stands in the name.

    Attributes:
        scene: number of the scene, attempt: number within it.
        object_name, shape_class: of the object that was gripped at.
        item: its number in the scene, -1 = none.
        outcome: how it ended; "no grasp found" where the planner answered none, "pushed" of a push.
        score: of the grasp.
        source: proposer of the grasp.
        seconds: the planner's time, cpu_seconds: of that, what its process computed, stage_times: the parts of
            `seconds` as the planner reports them [s].
        candidates: grasps that the planner answered.
        rejected: candidates that it refused, by reason.
        position, rotation, pre_grasp, grasp, reference_point, motion: of the executed grasp (rotation row by row).
        pd_mm, pv_mm3: penetration of the predicted final hand in the objects as they lay.
        pd_closed_mm, pv_closed_mm3: the same of the hand and objects as they were after closing.
    """

    scene: int
    attempt: int
    object_name: str = ""
    shape_class: str = ""
    item: int = -1
    outcome: str = NO_GRASP
    score: float = 0.0
    source: str = ""
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    stage_times: dict[str, float] = field(default_factory=dict)
    candidates: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    position: tuple[float, ...] = ()
    rotation: tuple[float, ...] = ()
    pre_grasp: tuple[float, ...] = ()
    grasp: tuple[float, ...] = ()
    reference_point: tuple[float, ...] = ()
    motion: tuple[float, ...] = ()
    pd_mm: float = 0.0
    pv_mm3: float = 0.0
    pd_closed_mm: float = 0.0
    pv_closed_mm3: float = 0.0

    @property
    def pushed(self) -> bool:
        """Whether it was a push, which is no attempt at a grasp."""
        return self.outcome == Outcome.PUSHED.value

    @property
    def executed(self) -> bool:
        """Whether the hand tried to grasp."""
        return self.outcome != NO_GRASP and not self.pushed

    @property
    def success(self) -> bool:
        """Whether an object was lifted and held."""
        return self.outcome == Outcome.SUCCESS.value


@dataclass(frozen=True)
class Item:
    """An object of a scene: what it is, how it lay at the beginning (see `resting_kind`), and whether it was lifted."""

    name: str
    shape_class: str
    kind: str
    cleared: bool
    material: str = OPAQUE


@dataclass(frozen=True)
class SceneResult:
    """One scene: how many objects it had, how many were lifted, every attempt, and every object."""

    scene: int
    objects: int
    cleared: int
    attempts: tuple[AttemptRecord, ...]
    items: tuple[Item, ...] = ()


def draw_scene(catalogue: Sequence[ObjectModel], setting: Setting, number: int) -> Scene:
    """Scene `number` of a setting: objects drawn without repetition, dropped, settled."""
    rng = np.random.default_rng([setting.seed, 101, number])
    low, high = setting.objects_per_scene
    count = int(rng.integers(low, high + 1))
    chosen = rng.choice(len(catalogue), min(count, len(catalogue)), replace=False)
    return make_scene(catalogue, chosen.tolist(), [setting.seed, 102, number], setting.area)


def plan(
    planner: Planner, view: View, rng: np.random.Generator, request: PlanRequest = PlanRequest()
) -> Prediction:
    """The planner's answer; no grasps where it says that it sees nothing to grasp."""
    try:
        return planner(view.points, view.camera, rng, request)
    except DgsError as error:
        if error.code not in _NOTHING_SEEN:
            raise
        return Prediction(GraspSet.empty(), len(view.points), {}, {error.code.name: 1})


class SceneRun:
    """Clears one scene, attempt by attempt."""

    def __init__(
        self, world: SceneWorld, planner: Planner, setting: Setting, number: int, views: ViewSettings
    ):
        self.world = world
        self.planner = planner
        self.setting = setting
        self.number = number
        self.views = views
        self.rng = np.random.default_rng([setting.seed, 103, number])
        self.meter = PenetrationMeter()
        self.attempts: list[AttemptRecord] = []
        self.failures: Counter[int] = Counter()
        self.pushes: Counter[int] = Counter()
        self.failed = FailedGrasps()
        self.cleared: set[int] = set()
        self.executed: Attempt | None = None

    def attempt(self) -> View:
        """Capture, plan and, where there is a grasp, execute it; returns what the planner saw.

        `executed` is then how the hand fared, None if there was no grasp.
        """
        self.executed = None
        models, poses = self.world.scene()
        view = capture(models, poses, self.rng, self.views, self.setting.edge)
        started, computed = time.perf_counter(), time.process_time()
        answer = plan(self.planner, view, self.rng, PlanRequest(failed=self.failed.poses))
        record = AttemptRecord(
            scene=self.number,
            attempt=len(self.attempts),
            seconds=time.perf_counter() - started,
            cpu_seconds=time.process_time() - computed,
            stage_times=answer.stage_times,
            candidates=len(answer.grasps),
            rejected=answer.rejected,
        )
        if len(answer.grasps):
            record = self._execute(record, answer.grasps[0], models, poses)
        self.attempts.append(record)
        return view

    def _execute(
        self, record: AttemptRecord, grasp: GraspSet, models: Sequence[ObjectModel], poses: Sequence[Array]
    ) -> AttemptRecord:
        result = self.executed = self.world.execute(grasp)
        predicted = closed = NO_PENETRATION
        if grasp.holds:
            predicted = self.meter(grasp.grasp_joints, grasp.closing_pose, models, poses)
            after = result.closed
            closed = self.meter(after.joints, after.T_table_tcp, models, list(after.objects.values()))
        target = self.world.models[result.object_index]
        self._take_away(result)
        self.failed.note(grasp, result.outcome in (Outcome.SUCCESS, Outcome.PUSHED))
        return replace(
            record,
            object_name=target.name,
            shape_class=target.shape_class,
            item=result.object_index,
            outcome=result.outcome.value,
            score=float(grasp.score),
            source=str(grasp.source),
            position=tuple(grasp.position.tolist()),
            rotation=tuple(grasp.rotation.ravel().tolist()),
            pre_grasp=tuple(grasp.pre_grasp_joints.tolist()),
            grasp=tuple(grasp.grasp_joints.tolist()),
            reference_point=tuple(grasp.reference_point.tolist()),
            motion=tuple(grasp.motion.tolist()),
            pd_mm=predicted.depth_mm,
            pv_mm3=predicted.volume_mm3,
            pd_closed_mm=closed.depth_mm,
            pv_closed_mm3=closed.volume_mm3,
        )

    def _take_away(self, result: Attempt) -> None:
        index = result.object_index
        if result.outcome is Outcome.SUCCESS:
            self.cleared.add(index)
            self.world.remove(index)
            return
        counts = self.pushes if result.outcome is Outcome.PUSHED else self.failures
        counts[index] += 1
        if self.failures[index] >= MAX_FAILURES or self.pushes[index] > MAX_PUSHES:
            self.world.remove(index)

    @property
    def finished(self) -> bool:
        """Nothing is left, or two views in a row gave no grasp."""
        blind = len(self.attempts) >= 2 and all(a.outcome == NO_GRASP for a in self.attempts[-2:])
        return blind or not self.world.left


def run_scene(
    catalogue: Sequence[ObjectModel],
    factory: PlannerFactory,
    setting: Setting,
    number: int,
    condition: Condition,
    engine: str,
    keep: Callable[[SceneRun, View], None] | None = None,
) -> SceneResult:
    """Clear one scene.

    Args:
        number: of the scene; scene, views and wear depend on it and the seed alone.
        condition: of views and hardware.
        engine: one of `engines.ENGINES`.
        keep: called after every attempt with the run and what the planner saw.
    """
    scene, key = draw_scene(catalogue, setting, number), [setting.seed, 104, number]
    with condition.world(catalogue, scene, engine, key, setting.edge) as world:
        planner = condition.disturb(factory(world.scene), key)
        run = SceneRun(world, planner, setting, number, condition.views(setting.seen))
        world.settle()
        kinds = {i: resting_kind(world.models[i], T) for i, T in world.object_poses().items()}
        while not run.finished:
            view = run.attempt()
            if keep is not None:
                keep(run, view)
            world.settle()
            world.drop_lost((setting.area[0] / 2 + SEEN, setting.area[1] / 2 + SEEN))
        items = tuple(
            Item(model.name, model.shape_class, kinds[i], i in run.cleared, model.material)
            for i, model in enumerate(world.models)
        )
        return SceneResult(number, len(items), len(run.cleared), tuple(run.attempts), items)
