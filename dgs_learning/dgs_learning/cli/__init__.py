"""Command line: the command `dgs`, a module per subcommand, or for several that belong together."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is imported; as in ros2_ws/setup_env.sh


def main() -> None:
    """Entry point of `dgs`."""
    from dgs_learning.cli.app import app

    app()
