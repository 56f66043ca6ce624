"""One carried hand, two engines: the same kinematics, contacts, friction and wear."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.frames import inverse, transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.hand_ik import reach_with_balls
from dgs_sim_bridge.render.object_model import from_parts
from dgs_sim_bridge.world.engines import ENGINES, open_world
from dgs_sim_bridge.world.hand_world import HandWorld, Wear

BLOCK = from_parts(
    "block", "cuboid", "block", [np.array(list(np.ndindex(2, 2, 2))) * (0.04, 0.12, 0.06)], 0.2
)
ABOVE = transform(position=(0.0, 0.0, 0.5))


def pinch(width: float) -> GraspSet:
    """Thumb against index, middle and ring finger across the TCP's x axis, 30 mm before the TCP."""
    balls = np.zeros((5, 3))
    balls[:, 2] = 0.030
    balls[0, 0], balls[1:, 0] = width / 2 + 0.011, -width / 2 - 0.011
    balls[1:, 1] = HAND.base_poses[1:, 1, 3]
    joints = reach_with_balls(HAND, balls)
    active = np.array([True, True, True, True, False])
    return GraspSet.of(
        "test",
        position=np.zeros((1, 3)),
        rotation=np.eye(3)[None],
        pre_grasp_joints=HAND.pre_grasp(joints, active).reshape(1, 20),
        grasp_joints=joints.reshape(1, 20),
        active_fingers=active,
        score=np.ones(1),
        reference_point=np.zeros((1, 3)),
    )[0]


def run(world: HandWorld, seconds: float) -> None:
    for _ in range(round(seconds / world.period)):
        world.step()


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def squeezed(engine: str, friction: float, wear: Wear | None = None) -> float:
    """How far the block falls when it is pinched in free space and gravity acts across the pinch [m]."""
    with open_world(engine, [BLOCK], [np.eye(4)], False, friction, wear) as world:
        world.place(0, transform(position=(0.0, 0.01, 0.030)))
        world.put_hand(np.eye(4), pinch(0.04).pre_grasp_joints)
        world.start_closing(pinch(0.04), 2.0)
        run(world, 1.0)
        held = world.object_pose(0)
        world.set_gravity((0.0, 0.0, 9.81))
        run(world, 0.4)
        return float(world.object_pose(0)[2, 3] - held[2, 3])


def test_objects_come_to_rest_on_the_table_and_go_away(engine: str) -> None:
    poses = [transform(position=(0.2 * k, 0.0, 0.035)) for k in range(2)]
    with open_world(engine, [BLOCK, BLOCK], poses, True) as world:
        world.put_hand(ABOVE, np.zeros(20))
        run(world, 0.5)
        assert [round(T[2, 3], 3) for T in world.object_poses().values()] == pytest.approx(
            [0.03] * 2, abs=0.002
        )
        world.remove(0)
        run(world, 0.1)
        assert list(world.object_poses()) == [1]
        assert world.object_pose(1)[:3, 3] == pytest.approx((0.2, 0.0, 0.03), abs=0.001)


def test_beyond_the_edge_there_is_no_table(engine: str) -> None:
    poses = [transform(position=(x, 0.0, 0.031)) for x in (-0.2, 0.1)]
    with open_world(engine, [BLOCK, BLOCK], poses, True, edge=-0.05) as world:
        world.put_hand(ABOVE, np.zeros(20))
        run(world, 0.5)
        assert world.object_pose(0)[2, 3] < -0.5
        assert world.object_pose(1)[:3, 3] == pytest.approx((0.1, 0.0, 0.03), abs=0.001)


def test_the_hand_goes_where_it_is_carried(engine: str) -> None:
    with open_world(engine, [], [], True) as world:
        turned = transform(((0, 0, 1), (1, 0, 0), (0, 1, 0)), (0.1, 0.2, 0.5))
        world.put_hand(turned, np.zeros(20))
        target = turned.copy()
        for _ in range(round(0.4 / world.period)):
            target[:3, 3] += np.array([0.1, -0.05, 0.05]) * world.period / 0.4
            world.carry(target)
            world.step()
        run(world, 0.2)
        assert world.hand_pose() == pytest.approx(target, abs=0.003)


def test_what_a_pinch_holds_is_a_matter_of_friction(engine: str) -> None:
    assert squeezed(engine, 0.8) < 0.005
    assert squeezed(engine, 0.02) > 0.05


def test_fingers_that_touch_are_named(engine: str) -> None:
    with open_world(engine, [BLOCK], [transform(position=(0.0, 0.01, 0.030))], False) as world:
        world.put_hand(np.eye(4), pinch(0.04).pre_grasp_joints)
        assert world.contacts(0) == set()
        world.start_closing(pinch(0.04), 2.0)
        run(world, 0.6)
        assert {0, 2} <= world.contacts(0) <= {0, 1, 2, 3}


def test_measured_joints_are_off_by_the_zeros(engine: str) -> None:
    zeros = np.tile([0.0, 0.03, -0.02, -0.02], 5)
    with (
        open_world(engine, [], [], False, wear=Wear(zeros=zeros)) as worn,
        open_world(engine, [], [], False) as new,
    ):
        joints = np.tile([0.0, 0.4, 0.3, 0.3], 5)
        for world, true in ((worn, joints - zeros), (new, joints)):
            world.put_hand(np.eye(4), joints)
            assert world.joints()[0] == pytest.approx(joints, abs=1e-6)
            assert world.posture() == pytest.approx(true, abs=1e-6)


def test_a_worn_hand_closes_later_and_holds_less(engine: str) -> None:
    reached = []
    for wear in (Wear(), Wear(delay=0.1), Wear(backlash=0.05)):
        with open_world(engine, [], [], False, wear=wear) as world:
            grasp = pinch(0.04)
            world.put_hand(np.eye(4), grasp.pre_grasp_joints)
            world.start_closing(grasp, 2.0)
            run(world, 0.15)
            reached.append(world.joints()[0][6] - grasp.pre_grasp_joints[6])
    new, late, loose = reached
    assert late < 0.6 * new
    assert loose == pytest.approx(new - 0.025, abs=0.01)


def test_a_worn_hand_has_less_torque(engine: str) -> None:
    used = []
    for effort in (1.0, 0.1):
        start = transform(position=(0.0, 0.01, 0.030))
        with open_world(engine, [BLOCK], [start], False, wear=Wear(effort=effort)) as world:
            world.put_hand(np.eye(4), pinch(0.04).pre_grasp_joints)
            world.start_closing(pinch(0.04), 2.0)
            run(world, 0.6)
            used.append(np.max(np.abs(world.joints()[1]) / HAND.effort))
    assert used[1] <= 0.1001 < used[0]


def test_both_engines_have_the_same_hand() -> None:
    joints = np.tile([0.1, 0.5, 0.4, 0.4], 5)
    poses = []
    for name in ENGINES:
        with open_world(name, [BLOCK], [transform(position=(0.0, 0.01, 0.030))], False) as world:
            world.put_hand(ABOVE, joints)
            run(world, 0.1)
            poses.append((world.hand_pose(), world.joints()[0]))
    assert inverse(poses[0][0]) @ poses[1][0] == pytest.approx(np.eye(4), abs=1e-6)
    assert poses[0][1] == pytest.approx(poses[1][1], abs=0.002)


def test_an_unknown_engine_is_refused() -> None:
    with pytest.raises(ValueError, match="no engine 'ode'"):
        open_world("ode", [], [], False)
