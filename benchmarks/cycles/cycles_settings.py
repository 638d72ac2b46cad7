"""Settings of Cycles that are compared, from one sample per pixel to Blender's defaults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class CyclesSetting:
    """One way to render a frame with Cycles.

    Attributes:
        name: in tables and file names.
        spp: samples per pixel; the maximum for adaptive sampling.
        denoise: use Open Image Denoise, with Cycles' albedo and normal passes.
        bounces: scattering events after the first hit.
        clamp: limit of the indirect light of a sample, relative to full scale; 0 is no limit.
        adaptive: noise threshold of adaptive sampling; None samples all pixels equally.
        filter_glossy: Blender's blurring of gloss after diffuse bounces; 0 is none.
        frames: number of frames with different seeds; None takes the caller's number.
        limit_s: time after which no third or further frame is started; 0 is no limit.
    """

    name: str
    spp: int
    denoise: bool
    bounces: int = 8
    clamp: float = 0.0
    adaptive: float | None = None
    filter_glossy: float = 0.0
    frames: int | None = None
    limit_s: float = 0.0

    def __post_init__(self) -> None:
        if self.spp < 1 or self.bounces < 0 or (self.frames is not None and self.frames < 1):
            raise ValueError(f"{self.name}: spp and frames must be at least 1, bounces at least 0")
        if min(self.clamp, self.filter_glossy, self.limit_s, self.adaptive or 0.0) < 0.0:
            raise ValueError(f"{self.name}: clamp, filter_glossy, adaptive and limit_s must not be negative")


STANDARD_SETTINGS: Final[tuple[CyclesSetting, ...]] = (
    *(CyclesSetting(f"raw {spp}", spp, denoise=False) for spp in (1, 4, 16, 64, 256)),
    *(CyclesSetting(f"denoised {spp}", spp, denoise=True) for spp in (4, 8, 16, 64)),
    *(CyclesSetting(f"clamped raw {n}", n, denoise=False, clamp=10.0, filter_glossy=1.0) for n in (16, 64)),
    CyclesSetting("clamped denoised 16", 16, denoise=True, clamp=10.0, filter_glossy=1.0),
    CyclesSetting(
        "Blender's defaults", 4096, denoise=False, bounces=12, clamp=10.0, adaptive=0.01, filter_glossy=1.0
    ),
    CyclesSetting(
        "as BlenderProc", 1024, denoise=True, bounces=3, clamp=10.0, adaptive=0.01, filter_glossy=1.0
    ),
)
"""Raw and denoised sampling, the same with Blender's clamping, the settings of a new Blender file (adaptive
up to 4,096 samples, 12 bounces), and those of BlenderProc (1,024 adaptive, 3 bounces, denoised)."""

REFERENCE: Final = CyclesSetting("reference", 256, denoise=False, frames=8, limit_s=600.0)
"""2,048 samples as eight frames with different seeds, whose spread gives the error of their mean. No further
frame is started after ten minutes."""
