"""Make the suite importable in the virtual environment that runs this, without ROS; put the command `dgs` there.

A plain .pth file with the source roots is used on purpose: seen from the repository's root, the folder
`dgs_perception/` looks like a namespace package, and the import hook of an editable install would lose against it.
"""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path

REPO_ROOT = Path(__file__).resolve().parents[2]
SOURCE_ROOTS = (
    "dgs_perception",
    "dgs_grasp_planner",
    "dgs_arm_executor",
    "dgs_hand_driver",
    "dgs_sim_bridge",
    "dgs_learning",
    "ros2_ws/src/dgs_description",
    "ros2_ws/src/dgs_ros",
    "ros2_ws/src/dgs_bringup",
    "ros2_ws/src/dgs_viewer",
)
DGS_COMMAND = """#!{python}
import sys

from dgs_learning.cli import main

if __name__ == "__main__":  # a process that dask starts reads this file, too
    sys.exit(main())
"""


def main() -> int:
    """Write dgs_suite.pth and bin/dgs; return the exit code."""
    if sys.prefix == sys.base_prefix:
        print("link_sources.py: run me with the python of a virtual environment", file=sys.stderr)
        return 1
    pth = Path(sysconfig.get_path("purelib")) / "dgs_suite.pth"
    pth.write_text("".join(f"{REPO_ROOT / root}\n" for root in SOURCE_ROOTS))
    command = Path(sysconfig.get_path("scripts")) / "dgs"
    command.write_text(DGS_COMMAND.format(python=sys.executable))
    command.chmod(0o755)
    return 0


if __name__ == "__main__":
    sys.exit(main())
