"""The page's picture: robot, cell, cloud, predicted hands, planned path, target."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from dgs_description import urdf_parts
from dgs_description.arm_model import forward_kinematics
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_description.link_tree import LinkTree
from dgs_description.urdf import robot
from dgs_viewer.colours import of_score
from dgs_viewer.pointing import Box
from dgs_viewer.shapes import hand_instances, hand_meshes, instances, mesh_of
from dgs_viewer.state import Cloud, Offer, Sample

POINT_SIZE = 0.0035
GHOST, SOLID = 0.22, 0.92
"""Opacity of predicted hands and of the one that is chosen."""
REFUSED = np.array([120, 124, 130], np.uint8)
"""Colour of hands that the arm cannot bring there."""
CHOSEN = np.array([30, 110, 255], np.uint8)
TARGET = (255, 170, 0)
WAYS = {
    "transfer": (60, 150, 255),
    "approach": (0, 200, 140),
    "lift": (0, 200, 140),
    "carry": (170, 110, 255),
}
"""Colour of a motion's path by stage; others are grey."""
_OTHER_WAY = (150, 150, 160)
_PATH_POINTS = 60
_DIMMED = 0.45
"""Share of its own colour that the cell around the robot has, so that what the camera sees stands out."""
_SUNK = 0.004
"""The cell is drawn so far below its place, or the cloud would flicker through the table top [m]."""
_STILL = 1e-4
"""Smaller turns are not sent [rad]."""


class Scene:
    """What stands in the three-dimensional part of the page."""

    def __init__(self, server: viser.ViserServer) -> None:
        """Draw the cell, and the robot at home."""
        self._scene = server.scene
        self._server = server
        self._scene.set_up_direction("+z")
        self._scene.configure_default_lights(cast_shadow=False)
        self._scene.world_axes.visible = False
        self._tree = LinkTree(robot())
        self._links = self._draw_links()
        self._joints = np.full(len(ARM_JOINTS) + HAND.joint_count, np.inf)
        self._cloud: viser.PointCloudHandle | None = None
        self._hand_meshes = hand_meshes()
        self._hands: list[viser.SceneNodeHandle] = []

    def show_robot(self, sample: Sample) -> None:
        """Move the links to the sample's joints."""
        joints = np.concatenate([sample.arm, sample.hand])
        if np.abs(joints - self._joints).max() < _STILL:
            return
        self._joints = joints
        poses = self._tree.poses(dict(zip((*ARM_JOINTS, *HAND.joints), joints.tolist(), strict=True)))
        placed = instances(np.array([poses[name] for name in self._links]))
        with self._server.atomic():
            for handle, position, wxyz in zip(self._links.values(), *placed, strict=True):
                handle.position, handle.wxyz = position, wxyz

    def show_cloud(self, cloud: Cloud | None) -> None:
        """Replace the cloud."""
        if cloud is None:
            cloud = Cloud(np.zeros((0, 3), np.float16), np.zeros((0, 3), np.uint8))
        if self._cloud is None:
            self._cloud = self._scene.add_point_cloud(
                "/cloud", cloud.points, cloud.colours, point_size=POINT_SIZE, point_shape="circle",
                point_shading="flat",
            )  # fmt: skip
            return
        with self._server.atomic():
            self._cloud.points, self._cloud.colors = cloud.points, cloud.colours

    def show_offer(self, offer: Offer | None, most: int, closed: float) -> None:
        """Draw up to `most` hands, the chosen one solid, at a share of their closing; and the planned path."""
        with self._server.atomic():
            for handle in self._hands:
                handle.remove()
            self._hands = []
            if offer is None or len(offer.grasps) == 0:
                return
            chosen = max(offer.chosen, 0)
            others = [k for k in range(len(offer.grasps)) if k != chosen][: max(most - 1, 0)]
            colours = of_score(offer.grasps.score)
            refused = [k for k in offer.refusals if k < len(colours)]
            colours[refused] = REFUSED
            if offer.chosen >= 0:
                colours[offer.chosen] = CHOSEN
            if others:
                self._draw_hands("/hands/others", offer.grasps[others], colours[others], closed, GHOST)
            if most > 0:
                self._draw_hands("/hands/best", offer.grasps[[chosen]], colours[[chosen]], closed, SOLID)

    def show_path(self, offer: Offer | None) -> None:
        """Draw the way of the TCP through the planned motions."""
        self._scene.remove_by_name("/path")
        if offer is None or not offer.motions:
            return
        segments, colours = [], []
        for stage, joints in offer.motions:
            way = _way(joints)
            if len(way) < 2:
                continue
            segments.append(np.stack([way[:-1], way[1:]], axis=1))
            colours.append(np.tile(np.array(WAYS.get(stage, _OTHER_WAY), np.uint8), (len(way) - 1, 2, 1)))
        if segments:
            self._scene.add_line_segments(
                "/path",
                np.concatenate(segments),
                np.concatenate(colours),
                thickness=3.0,
                thickness_units="screen",
            )

    def show_target(self, box: Box | None) -> None:
        """Draw the box in which grasps are wanted."""
        self._scene.remove_by_name("/target")
        if box is not None:
            self._scene.add_box(
                "/target", TARGET, box.size, opacity=0.18, position=box.centre, cast_shadow=False
            )

    def _draw_links(self) -> dict[str, viser.MeshHandle]:
        """Handles of the moving links by name; what stands around is drawn once and for all."""
        around = urdf_parts.surroundings()
        places = LinkTree(around).poses({})
        drawn = {}
        for link in (*around.links, *robot().links):
            if not link.shapes:
                continue
            fixed = link in around.links
            colour = np.multiply(link.colour, 255 * (_DIMMED if fixed else 1.0)).astype(np.uint8)
            vertices, faces = mesh_of(link.shapes)
            folder = "cell" if fixed else "robot"
            handle = self._scene.add_mesh_simple(
                f"/{folder}/{link.name}",
                vertices,
                faces,
                color=colour,
                cast_shadow=False,
                receive_shadow=False,
            )
            if fixed:
                place = instances(places[link.name])
                handle.position, handle.wxyz = place.positions[0] - (0.0, 0.0, _SUNK), place.wxyz[0]
            else:
                drawn[link.name] = handle
        return drawn

    def _draw_hands(
        self, name: str, grasps: GraspSet, colours: NDArray[np.uint8], closed: float, opacity: float
    ) -> None:
        for part, placed in hand_instances(grasps, closed).items():
            vertices, faces = self._hand_meshes[part]
            handle = self._scene.add_batched_meshes_simple(
                f"{name}/{part}", vertices, faces, placed.wxyz, placed.positions, batched_colors=colours,
                opacity=opacity, lod="off", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._hands.append(handle)


def _way(joints: Array) -> Array:
    """(M, 3) places of the TCP on a motion of (N, 6) arm joints [rad]."""
    rows = np.unique(np.linspace(0, len(joints) - 1, min(len(joints), _PATH_POINTS)).round().astype(int))
    return (forward_kinematics(joints[rows]) @ HAND.T_mount_tcp)[:, :3, 3]
