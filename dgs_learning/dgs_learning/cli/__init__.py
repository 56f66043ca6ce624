"""Command line: the command `dgs`, a module per subcommand, or for several that belong together."""

from __future__ import annotations


def main() -> None:
    """Entry point of `dgs`."""
    from dgs_learning.cli.app import app

    app()
