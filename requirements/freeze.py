"""Write constraints.txt: the versions of everything pip installed in the virtual environment that runs this."""

from __future__ import annotations

import re
import sys
from importlib.metadata import distributions
from pathlib import Path

HEADER = """\
# Every package of the tested environment, the indirect ones too (Python 3.11). Used with `pip install -c`;
# written by `make constraints`.
"""


def main() -> int:
    """Write the file and return the exit code."""
    versions = {}
    for distribution in distributions():
        # The ROS wheels carry egg-info folders of their inner packages, which pip cannot install by name.
        if (distribution.read_text("INSTALLER") or "").strip() != "pip":
            continue
        name = re.sub(r"[-_.]+", "-", distribution.metadata["Name"]).lower()
        if name != "pip":
            versions[name] = distribution.version.split("+")[0]
    lines = [f"{name}=={version}\n" for name, version in sorted(versions.items())]
    (Path(__file__).parent / "constraints.txt").write_text(HEADER + "".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
