"""Command line: the command `dgs`, one module per subcommand."""

from __future__ import annotations


def main() -> None:
    """Entry point of `dgs`."""
    from dgs_learning.cli.app import app

    app()
