"""Installs dgs_bringup as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "dgs_bringup"
DATA_FOLDERS = ("launch", "config", "scripts")

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Launch files, parameters, scripts and the task that clears a table.",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *[
            (f"share/{PACKAGE}/{folder}", sorted(str(file) for file in Path(folder).glob("*.*")))
            for folder in DATA_FOLDERS
        ],
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "clear_table = dgs_bringup.clear_table_node:main",
            "plan_pick = dgs_bringup.plan_pick:main",
        ],
    },
)
