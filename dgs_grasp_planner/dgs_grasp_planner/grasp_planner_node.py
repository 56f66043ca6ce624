"""Serves /predict_grasps: DGS-Net on a cloud of the request or on the newest cloud of /dgs/cloud."""

from __future__ import annotations

import threading
import time
import traceback
from concurrent.futures import CancelledError, ThreadPoolExecutor, wait
from functools import cache
from typing import Any

import numpy as np
from dgs_interfaces.msg import GraspArray
from dgs_interfaces.srv import PredictGrasps
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, apply
from dgs_description.grasp import GraspSet
from dgs_description.paths import weights_dir
from dgs_grasp_planner.cell_planner import predict_in_cell
from dgs_grasp_planner.marker_msgs import grasps_to_markers
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_grasp_planner.predict_msgs import brings_cloud, fill_error, fill_success, read_request
from dgs_grasp_planner.preprocess import check_points
from dgs_grasp_planner.runtime import prepare_process
from dgs_grasp_planner.scene import Planner, PlanRequest, Prediction
from dgs_ros.base_node import LATCHED
from dgs_ros.cloud_msgs import cloud_to_numpy
from dgs_ros.diagnostics import Level
from dgs_ros.grasp_msgs import grasps_to_msgs
from dgs_ros.managed_node import ManagedNode
from dgs_ros.run import run
from dgs_ros.static_frames import StaticFrames

SERVICE_QOS = QoSProfile(depth=64)
"""Deeper than the default 10: replies that refuse a burst of requests must not push one another out."""


class GraspPlannerNode(ManagedNode[PlannerParameters]):
    """Parameters, topics and the service; the work is done by a planner in a thread of its own.

    Starts without the hand's weights as well: requests are answered WEIGHTS_MISSING, WEIGHTS_ALTERED or WRONG_HAND
    until they are right. A model of another name has to be there.
    """

    def __init__(self, **node_arguments: Any) -> None:
        """Subscribe to clouds and frames."""
        # Before any other thread runs: scipy looks into torch once it is imported, and must not find it half loaded.
        import torch  # noqa: F401

        super().__init__("grasp_planner_node", PlannerParameters, **node_arguments)
        p = self.parameters
        self._said: set[str] = set()
        self._frames = StaticFrames(self, self._said.add)
        # Until /tf_static says otherwise.
        self._frames.set(BASE_LINK, CELL.optical_frame, CELL.T_base_camera_optical)
        self._planner = cache(self._load)  # which is tried again at the next call where it raises
        self._model = ("", "")
        self._offered = False
        self._newest: tuple[PointCloud2, float] | None = None
        self._grasps = self.create_publisher(GraspArray, "/dgs/grasps", LATCHED)
        self._markers = self.create_publisher(MarkerArray, "/dgs/grasp_markers", LATCHED)
        self._inference = ThreadPoolExecutor(1, thread_name_prefix="inference")
        self._places = threading.Semaphore(p.queue_length + 1)
        # Every request in work or in the queue holds a thread; others refuse more of them, and serve the rest.
        self.pool_threads += p.queue_length + 1
        self.create_subscription(PointCloud2, p.cloud_topic, self._on_cloud, qos_profile_sensor_data)

    def start(self) -> None:
        """Load the model. Raises DgsError REQUEST_INVALID: no GPU; WEIGHTS_MISSING: of a model that is named."""
        self._inference.submit(self._prepare).result()

    def serve(self) -> None:
        """Offer the service: who sees it gets answers at once."""
        if self._offered:
            return
        self._offered = True
        qos, group = SERVICE_QOS, ReentrantCallbackGroup()
        self.create_service(
            PredictGrasps, "/predict_grasps", self._on_request, qos_profile=qos, callback_group=group
        )

    def close(self) -> None:
        """Forget the requests that wait; the one in work may end."""
        self._inference.shutdown(wait=False, cancel_futures=True)

    # callbacks

    def _on_cloud(self, cloud: PointCloud2) -> None:
        self._newest = (cloud, time.monotonic())

    def _on_request(
        self, request: PredictGrasps.Request, _: PredictGrasps.Response
    ) -> PredictGrasps.Response:
        """Wait for the answer of the inference thread, but not too long."""
        try:
            self.require_active()
        except DgsError as error:
            return self._refusal(error.code, error.message)
        limit = self.parameters.answer_timeout
        if not self._places.acquire(blocking=False):
            many = f"{self.parameters.queue_length} requests wait already: ask later"
            return self._refusal(ErrorCode.PLANNER_BUSY, many)
        try:
            work = self._inference.submit(self._serve, request, self._newest, time.monotonic())
            end = time.monotonic() + limit
            while not wait([work], timeout=min(0.1, max(end - time.monotonic(), 0.0))).done:
                if self.stopping.is_set():
                    return self._refusal(ErrorCode.PLANNER_BUSY, "the node ends")
                if time.monotonic() >= end:
                    break
            return work.result(0)
        except CancelledError:
            return self._refusal(ErrorCode.PLANNER_BUSY, "the node ends")
        except TimeoutError:
            if work.cancel():
                late = f"other requests took longer than {limit:g} s: ask again"
                return self._refusal(ErrorCode.PLANNER_BUSY, late)
            return self._refusal(ErrorCode.PLANNER_INTERNAL, f"the prediction took longer than {limit:g} s")
        finally:
            self._places.release()

    def _refusal(self, code: ErrorCode, message: str) -> PredictGrasps.Response:
        model_id, sha256 = self._model
        return PredictGrasps.Response(
            error_code=int(code), message=message, model_id=model_id, model_sha256=sha256
        )

    # the inference thread

    def _load(self) -> Planner:
        import torch

        from dgs_grasp_planner.load import planner_with
        from dgs_grasp_planner.propose.dgs_net import DgsNet

        p = self.parameters
        torch.set_num_threads(p.torch_threads)
        network = None
        if DgsNet.name in p.proposers:
            directory = weights_dir(p.models_dir)
            network = DgsNet.from_weights(directory, p.model, p.score_threshold, p.device, p.precision)
            seconds = network.warm_up()
            if network.info is not None:
                self._model = (network.info.model_id, network.info.sha256)
            self.get_logger().info(
                f"model {self._model[0]} {self._model[1][:12]} loaded, first pass {seconds:.2f} s"
            )
        return planner_with(network, p.proposers, p.settings(), p.push())

    def _prepare(self) -> None:
        try:
            self._planner()
            self.report(Level.OK, "ready", model=self._model[0], sha256=self._model[1])
        except DgsError as error:
            named = self.parameters.model != PlannerParameters.model
            if error.code == ErrorCode.REQUEST_INVALID or (named and error.code == ErrorCode.WEIGHTS_MISSING):
                raise
            self.get_logger().error(error.message)
            self.report(Level.ERROR, error.message)
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            self.report(Level.ERROR, f"the model could not be loaded: {error}")

    def _serve(
        self, request: PredictGrasps.Request, newest: tuple[PointCloud2, float] | None, received: float
    ) -> PredictGrasps.Response:
        """The answer to a request of a time [s], when `newest` was the newest cloud."""
        response = PredictGrasps.Response()
        try:
            wishes = read_request(request, self._frames)
            cloud = request.cloud if brings_cloud(request) else self._fresh(newest, received)
            prediction = self._predict(cloud, int(request.seed), wishes, response)
            fill_success(response, prediction, cloud.header)
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
        return response

    def _predict(
        self, cloud: PointCloud2, seed: int, wishes: PlanRequest, response: PredictGrasps.Response
    ) -> Prediction:
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
        T_base_camera = self._frames.pose(CELL.optical_frame)
        if T_base_camera is None:
            raise DgsError(
                ErrorCode.CLOUD_FRAME_UNKNOWN,
                f"/tf_static does not lead from {CELL.optical_frame} to {BASE_LINK}",
            )
        if CELL.optical_frame not in self._said:
            silent = f"/tf_static does not say where {CELL.optical_frame} is; the cell's pose of it is taken"
            self.get_logger().warning(silent, once=True)
        try:
            prediction = predict_in_cell(self._planner(), points, T_base_camera[:3, 3], seed, wishes)
        except DgsError:
            self._publish_grasps(GraspSet.empty(), cloud.header)
            raise
        self._publish_grasps(prediction.grasps, cloud.header)
        return prediction

    def _fresh(self, newest: tuple[PointCloud2, float] | None, received: float) -> PointCloud2:
        topic, limit = self.parameters.cloud_topic, self.parameters.max_cloud_age
        if newest is None:
            raise DgsError(
                ErrorCode.NO_CLOUD_YET, f"no cloud has come on {topic}: start the camera node or send a cloud"
            )
        cloud, arrived = newest
        age = received - arrived
        if age > limit:
            raise DgsError(
                ErrorCode.CLOUD_STALE,
                f"the newest cloud of {topic} came {age:.1f} s ago, {limit:g} s are allowed: check the camera",
            )
        return cloud

    def _publish_grasps(self, grasps: GraspSet, header: Header) -> None:
        header = Header(stamp=header.stamp, frame_id=BASE_LINK)
        self._grasps.publish(GraspArray(header=header, grasps=grasps_to_msgs(grasps)))
        self._markers.publish(grasps_to_markers(grasps, header))

    def _report_refusal(self, error: DgsError) -> None:
        broken = error.code in (ErrorCode.WEIGHTS_MISSING, ErrorCode.WEIGHTS_ALTERED, ErrorCode.WRONG_HAND)
        self.get_logger().warning(f"{error.code.name}: {error.message}")
        if broken:
            self.report(Level.ERROR, error.message, code=int(error.code))
        else:
            self.report_event(Level.WARN, error.message, code=int(error.code))


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_grasp_planner grasp_planner_node`."""
    prepare_process()
    run(GraspPlannerNode, args)
