"""The numbers that the DGS-Net paper prints (Tables II to V) with the setting of each, to stand beside ours."""

from __future__ import annotations

from dataclasses import dataclass, field

SETTING_10 = "240 novel scenes of 10 objects in 0.6 x 0.6 m, simulation"
SETTING_5 = "4-6 objects in 0.4 x 0.8 m, simulation"


@dataclass(frozen=True)
class PaperRow:
    """One row; rates in [0, 1], None where the paper prints nothing.

    Attributes:
        name: method or ablation.
        setting: objects per scene, workspace, data.
        sr, cr: success and clearance rate.
        time_s: per prediction [s].
        per_class: SR by shape class.
        pd_mm, pv_mm3: (mean, variance).
        diversity: D.
    """

    name: str
    setting: str
    sr: float | None = None
    cr: float | None = None
    time_s: float | None = None
    per_class: dict[str, float] = field(default_factory=dict)
    pd_mm: tuple[float, float | None] | None = None
    pv_mm3: tuple[float, float | None] | None = None
    diversity: float | None = None


def _classes(cuboid: float, cylinder: float, stick: float, sphere: float, bowl: float) -> dict[str, float]:
    return {"cuboid": cuboid, "cylinder": cylinder, "stick": stick, "sphere": sphere, "bowl": bowl}


TABLE_2 = {
    "pre_grasp": PaperRow(
        "DGS-Net without pre-grasp", SETTING_10, 0.6983, 0.8058,
        per_class=_classes(0.7179, 0.7224, 0.6872, 0.3207, 0.6521),
    ),
    "offset": PaperRow(
        "DGS-Net without offset", SETTING_10, 0.7110, 0.8207,
        per_class=_classes(0.7467, 0.7592, 0.6528, 0.3617, 0.6464),
    ),
    "none": PaperRow(
        "DGS-Net", SETTING_10, 0.7481, 0.8473, 0.45,
        per_class=_classes(0.7749, 0.7925, 0.7242, 0.4242, 0.7451),
    ),
}  # fmt: skip
"""By ablation."""

TABLE_3 = (
    PaperRow("HGC-Net", "10 objects, HGC-Net's objects", 0.719, 0.788, 0.25),
    PaperRow("DGS-Net", "10 objects, HGC-Net's objects", 0.7307, 0.8113, 0.45),
    PaperRow("DGS-Net", "10 objects in 0.6 x 0.6 m, the paper's objects and YCB", 0.7481, 0.8473, 0.45),
    PaperRow("DexGraspNet 2.0", "10 objects, the paper's objects and YCB", 0.7359, 0.8387, 0.5),
    PaperRow("DGS-Net", "4-6 objects in 0.4 x 0.8 m, the paper's objects and YCB", 0.8863, 0.8706, 0.45),
    PaperRow("Multi-FinGAN", "1 object, YCB", 0.60, None, 7.4),
    PaperRow("DVGG", "1 object, YCB", 0.724, None, 0.9),
    PaperRow("Humt et al.", "1 object, YCB", 0.952, None, 1.1),
)

TABLE_4 = (
    PaperRow("HGC-Net", "", pd_mm=(12.93, 5.28), pv_mm3=(13970.0, 13206.0), diversity=0.5123),
    PaperRow("GraspTTA", "", pd_mm=(8.21, 4.63), pv_mm3=(2647.70, 1744.08), diversity=0.4880),
    PaperRow("DVGG", "", pd_mm=(4.10, None), pv_mm3=(3800.0, None)),
    PaperRow("Dexonomy", "", pd_mm=(8.28, 7.76), pv_mm3=(7314.02, 10163.44), diversity=0.2570),
    PaperRow("DexGraspNet 2.0", "", pd_mm=(0.594, 7.13), pv_mm3=(1452.24, 3056.10), diversity=0.2714),
    PaperRow("DGS-Net", "", pd_mm=(0.375, 4.53), pv_mm3=(559.45, 1262.10), diversity=0.3518),
)

TABLE_5 = (
    PaperRow("DGS-Net", "real robot, 25 scenes of 4-6 objects in 0.4 x 0.8 m, 138 attempts", 0.7898, 0.8686),
    PaperRow("HGC-Net", "real robot", 0.667, 0.75),
    PaperRow("Kiatos et al.", "real robot", 0.74, 0.75),
    PaperRow("GraspIt!", "real robot", 0.585, 0.543),
)
