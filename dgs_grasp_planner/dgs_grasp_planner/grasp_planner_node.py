"""Serves /predict_grasps: DGS-Net on a cloud of the request or on the newest cloud of /dgs/cloud."""

from __future__ import annotations

import functools
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np
from dgs_interfaces.srv import PredictGrasps
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, CELL, apply
from dgs_description.grasp import GraspSet
from dgs_description.paths import models_dir
from dgs_grasp_planner.cell_planner import CellPlanner, check_points
from dgs_grasp_planner.frame_tree import FrameTree
from dgs_grasp_planner.marker_msgs import grasps_to_markers
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_grasp_planner.predict_msgs import brings_cloud, fill_error, fill_success, read_request
from dgs_grasp_planner.runtime import prepare_process
from dgs_grasp_planner.scene import Planner, Prediction
from dgs_grasp_planner.serial_worker import SerialWorker
from dgs_ros.base_node import LATCHED, DgsNode
from dgs_ros.cloud_msgs import cloud_to_numpy
from dgs_ros.diagnostics import Level
from dgs_ros.pose_msgs import transform_to_matrix
from dgs_ros.run import run

TF_STATIC = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
SERVICE_QOS = QoSProfile(
    depth=64, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE
)
"""Deeper than the default 10: replies that refuse a burst of requests must not push one another out."""
WATCH_PERIOD = 0.1

Reply = Callable[[Any], None]


class DeferredService:
    """A service whose replies are sent later, from any thread.

    rclpy sends what the callback returns at once, and polls a coroutine that waits. Neither fits a network that runs
    in its own thread, so the executor's call of `send_response` is taken for the start of the work instead.
    """

    def __init__(self, node: Node, kind: Any, name: str, on_request: Callable[[Any, Reply], None]):
        self._on_request = on_request
        self._lock = threading.Lock()
        self._request: Any = None
        # Mutually exclusive: callback and send_response of one request come before those of the next.
        group = MutuallyExclusiveCallbackGroup()
        self._service = node.create_service(
            kind, name, self._take, qos_profile=SERVICE_QOS, callback_group=group
        )
        self._send = self._service.send_response
        self._service.send_response = self._defer

    def _take(self, request: Any, response: Any) -> Any:
        self._request = request
        return response

    def _defer(self, _: Any, header: Any) -> None:
        self._on_request(self._request, functools.partial(self._reply, header))

    def _reply(self, header: Any, response: Any) -> None:
        with self._lock:
            self._send(response, header)


class Pending:
    """A request that has not been answered yet; it is answered exactly once."""

    def __init__(
        self, request: PredictGrasps.Request, reply: Reply, newest: tuple[PointCloud2, float] | None
    ):
        self.request = request
        self.newest = newest
        self.received = time.monotonic()
        self.started = False
        self._reply = reply
        self._lock = threading.Lock()
        self.answered = False

    def answer(self, response: PredictGrasps.Response) -> bool:
        """Send the reply unless one was sent."""
        with self._lock:
            if self.answered:
                return False
            self.answered = True
        self._reply(response)
        return True


class GraspPlannerNode(DgsNode[PlannerParameters]):
    """Parameters, topics and the service; the work is done by `CellPlanner` in a thread of its own.

    Starts without weights as well: requests are answered WEIGHTS_MISSING or WEIGHTS_ALTERED until they are right.
    """

    def __init__(self, **node_arguments: Any) -> None:
        """Offer the service and begin to load the model."""
        # Before any other thread runs: scipy looks into torch once it is imported, and must not find it half loaded.
        import torch  # noqa: F401

        super().__init__("grasp_planner_node", PlannerParameters, **node_arguments)
        p = self.parameters
        self._frames = FrameTree()
        self._frames.set(
            BASE_LINK, p.camera_frame, CELL.T_base_camera_optical
        )  # until /tf_static says otherwise
        self._cell = CellPlanner(self._load)
        self._model = ("", "")
        self._newest: tuple[PointCloud2, float] | None = None
        self._pending: list[Pending] = []
        self._pending_lock = threading.Lock()
        self._markers = self.create_publisher(MarkerArray, "/dgs/grasp_markers", LATCHED)
        self._worker = SerialWorker("inference", p.queue_length + 1)
        self._worker.submit(self._prepare)
        self._cloud_subscription = self.create_subscription(
            PointCloud2, p.cloud_topic, self._on_cloud, qos_profile_sensor_data
        )
        self._tf_subscription = self.create_subscription(
            TFMessage, "/tf_static", self._on_transforms, TF_STATIC
        )
        self.every(WATCH_PERIOD, self._watch)
        self._service = DeferredService(self, PredictGrasps, "/predict_grasps", self._on_request)

    def close(self) -> None:
        """Let the running inference end."""
        self._worker.stop(1.0)

    # callbacks: short, never waiting

    def _on_cloud(self, cloud: PointCloud2) -> None:
        self._newest = (cloud, time.monotonic())

    def _on_transforms(self, message: TFMessage) -> None:
        for item in message.transforms:
            try:
                self._frames.set(
                    item.header.frame_id, item.child_frame_id, transform_to_matrix(item.transform)
                )
            except DgsError as error:
                self.get_logger().warning(f"/tf_static: {item.child_frame_id} ignored, {error.message}")

    def _on_request(self, request: PredictGrasps.Request, reply: Reply) -> None:
        pending = Pending(request, reply, self._newest)
        if not self._worker.submit(functools.partial(self._serve, pending)):
            self._refuse(
                pending,
                ErrorCode.PLANNER_BUSY,
                f"{self.parameters.queue_length} requests wait already: ask later",
            )
            return
        with self._pending_lock:
            self._pending.append(pending)

    def _watch(self) -> None:
        limit = self.parameters.answer_timeout
        with self._pending_lock:
            self._pending = [pending for pending in self._pending if not pending.answered]
            late = [pending for pending in self._pending if time.monotonic() - pending.received > limit]
        for pending in late:
            if pending.started:
                self._refuse(
                    pending, ErrorCode.PLANNER_INTERNAL, f"the prediction took longer than {limit:g} s"
                )
            else:
                self._refuse(
                    pending, ErrorCode.PLANNER_BUSY, f"other requests took longer than {limit:g} s: ask again"
                )

    # the inference thread

    def _load(self) -> Planner:
        import torch

        from dgs_grasp_planner.load import planner_with
        from dgs_grasp_planner.propose.dgs_net import DgsNet, DgsNetSettings

        p = self.parameters
        torch.set_num_threads(p.torch_threads)
        network = None
        if DgsNet.name in p.proposers:
            directory = models_dir(p.models_dir)
            settings = DgsNetSettings(score_threshold=p.score_threshold)
            network = DgsNet.from_weights(directory, p.model, settings, p.device, p.precision)
            seconds = network.warm_up()
            if network.info is not None:
                self._model = (network.info.model_id, network.info.sha256)
            self.get_logger().info(
                f"model {self._model[0]} {self._model[1][:12]} loaded, first pass {seconds:.2f} s"
            )
        return planner_with(network, p.proposers, p.settings())

    def _prepare(self) -> None:
        try:
            self._cell.planner()
            self.report(Level.OK, "ready", model=self._model[0], sha256=self._model[1])
        except DgsError as error:
            self.get_logger().error(error.message)
            self.report(Level.ERROR, error.message)
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            self.report(Level.ERROR, f"the model could not be loaded: {error}")

    def _serve(self, pending: Pending) -> None:
        if pending.answered:
            return
        pending.started = True
        response = PredictGrasps.Response()
        try:
            prediction, header = self._predict(pending, response)
            fill_success(response, prediction, header)
            times: dict[str, Any] = {k: f"{v:.3f} s" for k, v in prediction.stage_times.items()}
            self.report(Level.OK, response.message, **times)
        except DgsError as error:
            fill_error(response, error)
            self._report_refusal(error)
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            fill_error(
                response, DgsError(ErrorCode.PLANNER_INTERNAL, f"internal error, see the log: {error}")
            )
            self.report(Level.ERROR, response.message)
        response.model_id, response.model_sha256 = self._model
        self._send(pending, response)

    def _predict(self, pending: Pending, response: PredictGrasps.Response) -> tuple[Prediction, Header]:
        request = pending.request
        wishes = read_request(request, self._frames)
        cloud = request.cloud if brings_cloud(request) else self._newest_cloud(pending)
        T_base_cloud = self._frames.pose(cloud.header.frame_id)
        if T_base_cloud is None:
            raise DgsError(
                ErrorCode.CLOUD_FRAME_UNKNOWN,
                f"frame '{cloud.header.frame_id}' of the cloud is unknown: use {BASE_LINK} or publish it on /tf_static",
            )
        received = cloud_to_numpy(cloud)
        response.points_in = len(received)
        valid = check_points(received, self.parameters.skip_invalid_points)
        points = apply(T_base_cloud, valid.astype(np.float64))
        T_base_camera = self._frames.pose(self.parameters.camera_frame)
        if T_base_camera is None:
            raise DgsError(
                ErrorCode.CLOUD_FRAME_UNKNOWN,
                f"/tf_static does not lead from {self.parameters.camera_frame} to {BASE_LINK}",
            )
        try:
            prediction = self._cell.predict(points, T_base_camera[:3, 3], int(request.seed), wishes)
        except DgsError:
            self._publish_markers(GraspSet.empty(), cloud.header)
            raise
        self._publish_markers(prediction.grasps, cloud.header)
        return prediction, cloud.header

    def _newest_cloud(self, pending: Pending) -> PointCloud2:
        topic, limit = self.parameters.cloud_topic, self.parameters.max_cloud_age
        if pending.newest is None:
            raise DgsError(
                ErrorCode.NO_CLOUD_YET, f"no cloud has come on {topic}: start the camera node or send a cloud"
            )
        cloud, arrived = pending.newest
        age = pending.received - arrived
        if age > limit:
            raise DgsError(
                ErrorCode.CLOUD_STALE,
                f"the newest cloud of {topic} came {age:.1f} s ago, {limit:g} s are allowed: check the camera",
            )
        return cloud

    def _publish_markers(self, grasps: GraspSet, header: Header) -> None:
        self._markers.publish(grasps_to_markers(grasps, Header(stamp=header.stamp, frame_id=BASE_LINK)))

    # replies

    def _report_refusal(self, error: DgsError) -> None:
        broken = error.code in (ErrorCode.WEIGHTS_MISSING, ErrorCode.WEIGHTS_ALTERED)
        self.get_logger().warning(f"{error.code.name}: {error.message}")
        if broken:
            self.report(Level.ERROR, error.message, code=int(error.code))
        else:
            self.report_event(Level.WARN, error.message, code=int(error.code))

    def _refuse(self, pending: Pending, code: ErrorCode, message: str) -> None:
        response = PredictGrasps.Response()
        fill_error(response, DgsError(code, message))
        response.model_id, response.model_sha256 = self._model
        self._send(pending, response)

    def _send(self, pending: Pending, response: PredictGrasps.Response) -> None:
        try:
            pending.answer(response)
        except Exception as error:  # the node is being destroyed, or the client is gone
            if not self.stopping.is_set():
                self.get_logger().warning(f"a reply could not be sent: {error}")


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_grasp_planner grasp_planner_node`."""
    prepare_process()
    run(GraspPlannerNode, args)
