"""`dgs bench-training`: samples per second of a training, and where the time of a sample goes."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from dgs_learning import paths
from dgs_learning.cli.files import put_out
from dgs_learning.cli.options import Dataset, Json, Threads


def bench_training(
    json_file: Json = None,
    preset: Annotated[str, typer.Option(help="Network configuration.")] = "fast",
    batch: Annotated[int, typer.Option(min=1, help="Samples per step.")] = 10,
    steps: Annotated[int, typer.Option(min=1, help="Measured steps, after one that does not count.")] = 4,
    threads: Threads = 1,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    precision: Annotated[str, typer.Option(help="fp32, bf16, or auto = bf16 where it is faster.")] = "auto",
    dataset: Dataset = None,
) -> None:
    """Rate of a training without workers, by stage; on a CPU in processor time, for other load counts little then."""
    from dgs_grasp_planner.runtime import prepare_process

    prepare_process()
    from dgs_learning.training.settings import TrainingSettings

    settings = TrainingSettings(
        steps=steps + 1, batch=batch, threads=threads, device=device, precision=precision, workers=0
    )
    measured = measure(dataset or paths.dataset_file(), preset, settings)
    put_out("training.txt", measured, json_file)


def measure(dataset: Path, preset: str, settings: Any) -> dict[str, Any]:
    """Measure the steps of some `TrainingSettings` after the first.

    Returns:
        JSON-ready: `samples_per_s`, and `stages`, seconds per sample to render a view, to label and tabulate it, and of
        the forward pass, the gradients and the update.

    Raises:
        DgsError: REQUEST_INVALID, see `training.start.prepare_training`.
    """
    import resource

    from dgs_description.stage_clock import StageClock
    from dgs_learning.cli.machine import measured_here
    from dgs_learning.training.batches import ViewDataset
    from dgs_learning.training.settings import Sampler
    from dgs_learning.training.start import TrainingFiles, prepare_training

    timer = time.process_time if settings.device == "cpu" else time.perf_counter
    with tempfile.TemporaryDirectory() as folder:
        trainer = prepare_training(preset, TrainingFiles(dataset, Path(folder)), settings)
        views = ViewDataset(trainer.source, settings.seed, augmented=True)
        for step, keys in enumerate(Sampler(trainer.settings, 0)):
            if step <= 1:  # the first step fills caches and the heap
                trainer.clock = StageClock(timer)
            with trainer.clock("view"):
                samples = [views[key] for key in keys]
            with trainer.clock("labels and tables"):
                batch = trainer.collate(samples)
            trainer.train_step(batch, measured=True)
    seen = (settings.steps - 1) * settings.batch
    stages = {name: seconds / seen for name, seconds in trainer.clock.times.items()}
    return {
        "samples_per_s": round(1 / sum(stages.values()), 3),
        "stages": {name: round(value, 6) for name, value in stages.items()},
        "timer": timer.__name__,
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "batch": settings.batch,
        "steps": settings.steps - 1,
        "threads": settings.threads,
        "device": settings.device,
        "precision": settings.precision,
        "network": {"config": preset, "parameters": trainer.net.parameter_count},
        "dataset": {**trainer.notes["dataset"], "scenes": len(trainer.source.dataset.scenes)},
        **measured_here(trainer.device.type),
    }
