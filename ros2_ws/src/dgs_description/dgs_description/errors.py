"""Error codes of the suite and its root exception.

Each node has a range: planner 100s, arm 200s, hand 300s, camera 400s, task 500s, simulator 600s.
"""

from __future__ import annotations

from enum import IntEnum

from dgs_description.words import shortened


class ErrorCode(IntEnum):
    """Numeric `error_code` of every service and action result; `SUCCESS` is 0."""

    SUCCESS = 0

    # anywhere
    JOINT_NAMES = 10
    DESCRIPTION_MISSING = 11
    PARAMETER_INVALID = 12
    JOINT_VALUES = 13
    POSE_INVALID = 14
    NODE_INTERNAL = 15
    WRONG_HAND = 16
    NODE_INACTIVE = 17

    # planner
    CLOUD_EMPTY = 100
    CLOUD_NOT_FINITE = 101
    CLOUD_FRAME_UNKNOWN = 102
    CLOUD_FORMAT = 103
    NO_CLOUD_YET = 104
    NO_OBJECTS = 105
    NO_GRASP = 106
    REQUEST_INVALID = 107
    WEIGHTS_MISSING = 108
    WEIGHTS_ALTERED = 109
    PLANNER_BUSY = 110
    PLANNER_INTERNAL = 111
    REGION_INVALID = 112
    CLOUD_STALE = 113
    CLOUD_NO_TABLE = 114

    # arm
    NO_CANDIDATES = 200
    GRASP_INVALID = 201
    OUT_OF_REACH = 202
    IK_FAILED = 203
    JOINT_LIMIT = 204
    COLLISION_STAND_OFF = 205
    COLLISION_APPROACH = 206
    COLLISION_LIFT = 207
    NO_PATH = 208
    NO_FEASIBLE_GRASP = 209
    JOINT_STATES_SILENT = 210
    STOPPED = 211
    CONTROLLER_UNAVAILABLE = 212
    TRAJECTORY_REJECTED = 213
    TRAJECTORY_ABORTED = 214
    SAFETY_ENVELOPE = 215
    PROTECTIVE_STOP = 216
    EXECUTION_CANCELLED = 217
    EXECUTOR_BUSY = 218
    NOTHING_HELD = 219
    LOST_OBJECT = 220
    EXTRINSICS_OFF = 221
    FRAME_UNKNOWN = 222
    ARM_INTERNAL = 223
    HAND_UNAVAILABLE = 224
    PAYLOAD_REFUSED = 225
    OBSTACLES_MISSING = 226
    OBSTACLES_STALE = 227
    SCENE_CHANGED = 228
    FORCE_LIMIT = 229

    # hand
    HAND_JOINT_NAMES = 300
    HAND_NOT_FINITE = 301
    HAND_LIMIT = 302
    HAND_SPEED = 303
    HAND_BUSY = 304
    HAND_BLOCKED = 305
    HAND_TIMEOUT = 306
    HAND_BUS = 307
    HAND_CANCELLED = 308
    HAND_MODE = 309
    HAND_COUPLING = 310
    HAND_SILENT = 311
    HAND_INTERNAL = 312
    HAND_PROTOCOL = 313

    # camera
    CAMERA_MISSING = 400
    CAMERA_SILENT = 401
    BAG_MISSING = 402
    BAG_TOPIC = 403
    CAMERA_INFO_INVALID = 404
    DEPTH_FORMAT = 405
    EXTRINSICS_INVALID = 406
    CAMERA_INTERNAL = 407
    CALIBRATION_DATA = 408
    DEPTH_SOURCE = 409

    # task
    TASK_PLANNER_UNAVAILABLE = 500
    TASK_ARM_UNAVAILABLE = 501
    TASK_ATTEMPTS_USED_UP = 502
    TASK_CANCELLED = 503
    TASK_STOPPED = 504
    TASK_BUSY = 505
    TASK_PLANNER_FAILED = 506
    TASK_ARM_FAILED = 507
    TASK_NO_CLOUD = 508

    # simulator
    SIM_CATALOGUE = 600
    SIM_REQUEST = 601
    SIM_FAULT_UNKNOWN = 602
    SIM_SCENE = 603


class DgsError(Exception):
    """Root of the suite's exceptions: a code for programs and a sentence for people.

    Attributes:
        code: the `ErrorCode` that a node puts into its reply.
        message: one sentence with the offending value, shortened, and what would be right.
    """

    def __init__(self, code: ErrorCode, message: str):
        self.code = ErrorCode(code)
        self.message = shortened(message)
        super().__init__(self.message)

    def __reduce__(self) -> tuple[type[DgsError], tuple[ErrorCode, str]]:
        """What another process gets of it: code and message."""
        return DgsError, (self.code, self.message)


class JointNameError(DgsError):
    """Joint names are missing, doubled or do not match the values."""

    def __init__(self, message: str):
        super().__init__(ErrorCode.JOINT_NAMES, message)
