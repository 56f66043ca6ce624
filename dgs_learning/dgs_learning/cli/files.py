"""What several subcommands do with files: find the dataset, write results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import typer

from dgs_description.documents import fill_block
from dgs_learning import paths
from dgs_learning.cli.refusal import refusals, refuse


def existing_dataset(file: Path | None) -> Path:
    """The dataset file that is given, or the shipped one; ends the command where there is none."""
    file = file or paths.dataset_file()
    if not file.is_file():
        refuse(f"there is no dataset at {file}: name one, or make one with `dgs grasps` and `dgs scenes`")
    return file


def write_json(file: Path | None, content: dict[str, Any]) -> None:
    """Write a result, and its folder, if a file is given."""
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def put_out(template: str, result: dict[str, Any], json_file: Path | None, doc: Path | None = None) -> None:
    """Print a result by a template of the reports, where it is `m`; write it, if a file is given.

    The same text goes between a document's marks of the template's name, if a document is given.
    """
    from dgs_learning.evaluation.report.templates import render  # loads the planner

    text = render(template, m=result)
    typer.echo(text)
    write_json(json_file, result)
    if doc is not None:
        with refusals(ValueError):
            fill_block(doc, Path(template).stem.replace("_", "-"), text)
