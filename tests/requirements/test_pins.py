"""Every requirement is pinned, and the pins agree with one another and with what is installed."""

from __future__ import annotations

import importlib.metadata
import re

import pytest

from tests.support.environment import REPO_ROOT, ros_environment

FOLDER = REPO_ROOT / "requirements"
PIN = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)(\[[a-z,]+\])?==(?P<version>[0-9][0-9A-Za-z.]*)$")
FILES = ["ros", "build", "runtime", "dev"]


def pins(name: str) -> dict[str, str]:
    lines = (FOLDER / f"{name}.txt").read_text().splitlines()
    result = {}
    for line in lines:
        if line and not line.startswith("#"):
            match = PIN.match(line)
            assert match, f"requirements/{name}.txt: {line!r} is not pinned with =="
            result[re.sub(r"[-_.]+", "-", match["name"]).lower()] = match["version"]
    return result


@pytest.mark.parametrize("name", FILES)
def test_pinned_and_in_the_constraints(name):
    constraints = pins("constraints")
    wanted = pins(name)
    assert wanted
    assert wanted == {package: constraints.get(package) for package in wanted}, "run `make constraints`"


def test_no_package_stands_in_two_files():
    names = [package for name in FILES for package in pins(name)]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("name", ["runtime", "dev"])
def test_installed_versions_are_the_pinned_ones(name):
    installed = {package: importlib.metadata.version(package).split("+")[0] for package in pins(name)}
    assert installed == pins(name)


def test_colcon_can_link_sources():
    """colcon's --symlink-install calls `setup.py develop`, which setuptools 80 changed."""
    assert int(pins("build")["setuptools"].split(".")[0]) < 80
    assert ros_environment()["PATH"]
