"""CPU time of absorbed light of a row, and the error of its leaves: python benchmarks/absorbed_light.py

The first call compiles the kernels; the second is measured. Growing the row is not part of it.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import pepperscene as ps
from pepperscene.building.scenes.light_tables import lit_scene


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recipe", default="barth2018", help="its first frame has 13 plants")
    parser.add_argument("--bands", default="par", help="names, separated by commas")
    parser.add_argument("--target-error", type=float, default=0.02)
    arguments = parser.parse_args()

    renderer = ps.FrameRenderer(arguments.recipe)
    scene = lit_scene(renderer, renderer.recipe.plan.frame(0), (300.0, 1100.0))
    tracer = ps.LightTracer(scene, arguments.bands.split(","))
    tracer.trace(target_error=1.0)
    wall, cpu = time.perf_counter(), time.process_time()
    light = tracer.trace(target_error=arguments.target_error)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu

    classes = np.array([item.organ_class for item in scene.mesh.instances])[light.instances]
    leaves = (classes == ps.OrganClass.LEAF) & (light.amounts.umol_s[0] > 0.0)
    errors = (light.amounts.umol_s_error[0] / np.maximum(light.amounts.umol_s[0], 1e-30))[leaves]
    print(f"{len(light.instances):,} organs, {leaves.sum():,} leaves, {light.samples.sum():,} light paths")
    print(f"time: {wall:.1f} s, CPU time: {cpu:.1f} s")
    print(
        f"standard error of leaves: median {np.median(errors):.2%}, 90 % below {np.quantile(errors, 0.9):.2%}"
    )


if __name__ == "__main__":
    main()
