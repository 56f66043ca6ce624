"""Pools the summaries of several demo runs: python -m dgs_bringup.series RUN_FOLDER... [--json FILE]."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def pool(summaries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sums and rates over runs.

    Args:
        summaries: contents of the runs' summary.json.

    Returns:
        objects, attempts, successes, cleared, sr = successes / attempts, cr = cleared / objects, seconds per attempt,
        and a row per run.

    Raises:
        ValueError: no run was given.
    """
    if not summaries:
        raise ValueError("no run to pool")
    objects, attempts, successes, cleared = (
        sum(int(run[key]) for run in summaries) for key in ("objects", "attempts", "successes", "cleared")
    )
    seconds = sum(float(run["seconds"]["total"]) for run in summaries)
    columns = ("seed", "objects", "attempts", "successes", "cleared", "error_code", "message", "revision")
    return {
        "objects": objects,
        "attempts": attempts,
        "successes": successes,
        "cleared": cleared,
        "sr": round(successes / max(attempts, 1), 4),
        "cr": round(cleared / max(objects, 1), 4),
        "seconds_per_attempt": round(seconds / max(attempts, 1), 1),
        "model": summaries[0].get("model", ""),
        "runs": [
            {**{key: run.get(key) for key in columns}, "seconds": run["seconds"]["total"]}
            for run in summaries
        ],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the pooled figures, and write them where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="run folders of the demo")
    parser.add_argument("--json", type=Path, help="file to write")
    given = parser.parse_args(arguments)
    missing = [run for run in given.runs if not (run / "summary.json").is_file()]
    if missing:
        print(f"no summary.json in {', '.join(map(str, missing))}", file=sys.stderr)
        return 2
    pooled = pool([json.loads((run / "summary.json").read_text()) for run in given.runs])
    print(
        f"{len(given.runs)} runs: {pooled['attempts']} attempts, SR {pooled['sr']:.0%}, "
        f"{pooled['cleared']} of {pooled['objects']} objects cleared (CR {pooled['cr']:.0%}), "
        f"{pooled['seconds_per_attempt']} s per attempt"
    )
    if given.json is not None:
        given.json.parent.mkdir(parents=True, exist_ok=True)
        given.json.write_text(json.dumps(pooled, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
