"""`dgs import`: mesh files to a folder of objects that simulator, synthesis and evaluation read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def import_meshes(
    meshes: Annotated[list[Path], typer.Argument(help="OBJ, STL, PLY, GLB files, or folders of them.")],
    out: Annotated[
        Path,
        typer.Option(file_okay=False, help="Folder that gets manifest.json; it may hold objects already."),
    ],
    scale: Annotated[float, typer.Option(help="Metres of the files' unit (0.001 for millimetres).")] = 1.0,
    up: Annotated[str, typer.Option(help="Axis that points up: y or z; default y for GLB, else z.")] = "",
    density: Annotated[float, typer.Option(help="For the mass [kg/m^3].")] = 400.0,
    mass: Annotated[float | None, typer.Option(help="Mass of every object instead [kg].")] = None,
    shape_class: Annotated[
        str, typer.Option(help="cuboid, cylinder, stick, sphere or bowl; else guessed.")
    ] = "",
    threshold: Annotated[float, typer.Option(help="Tolerated concavity (CoACD), 0.01 to 1.")] = 0.05,
    max_hulls: Annotated[int, typer.Option(min=1, help="Convex parts of an object, at most.")] = 16,
) -> None:
    """Simplify meshes, cut them into convex parts, and write them in the import format."""
    from dgs_learning.objects import mesh_import as meshing

    settings = meshing.ImportSettings(scale, up, density, mass, shape_class, threshold, max_hulls)
    paths = meshing.find_meshes(meshes)
    for path, name in zip(paths, meshing.names_of(paths), strict=True):
        record = meshing.import_mesh(path, name, out, settings)
        # After every object: what a stopped import has done stays.
        meshing.write_manifest(out, record)
        size = " x ".join(f"{1e3 * e:.0f}" for e in record["extents_obb_m"])
        guessed = " (guessed)" if record["shape_class_guessed"] else ""
        typer.echo(
            f"{name}: {record['shape_class']}{guessed}, {size} mm, {1e3 * record['mass_kg']:.0f} g, "
            f"{record['n_hulls']} convex parts, {record['visual_faces']} of {record['source_faces']} faces"
        )
    typer.echo(f"{len(paths)} objects -> {out / 'manifest.json'}")
