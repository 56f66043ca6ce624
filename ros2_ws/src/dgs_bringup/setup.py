"""Installs dgs_bringup as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "dgs_bringup"
DATA_FOLDERS = ("launch", "config", "scripts")


def data_files() -> list[tuple[str, list[str]]]:
    """Return (destination, files) for every folder below DATA_FOLDERS; the next build takes files added later."""
    folders = [Path(name) for name in DATA_FOLDERS]
    folders += [
        folder for name in DATA_FOLDERS for folder in sorted(Path(name).rglob("*")) if folder.is_dir()
    ]
    result = []
    for folder in folders:
        files = sorted(str(file) for file in folder.glob("*") if file.is_file())
        if files:
            result.append((f"share/{PACKAGE}/{folder}", files))
    return result


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Launch files, parameters, scripts and the task that clears a table.",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "*.dbc", "*.yaml", "*.json", "data/**/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *data_files(),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "clear_table = dgs_bringup.clear_table_node:main",
            "plan_pick = dgs_bringup.plan_pick:main",
        ],
    },
)
