"""Frames of the CPU and of the GPU agree, and a variant gives the same bits in every process.

Both variants of Mitsuba trace the same samples but round differently, and a ray near an edge may then take
another path: the same class and instance, and a distance within 1e-4, in all but 1e-3 of the pixels;
electrons within 1e-3 of the mean in nine of ten; means of channels within 2e-3. Variants that do not run on
this machine are skipped.
"""

import numpy as np
import pytest
from processes import run_python
from small_scenes import plants_view

from pepperscene.errors import SetupError
from pepperscene.render import Quality, render_scene, variant_name
from pepperscene.render.variant import VARIANTS, choose_variant

pytestmark = pytest.mark.long

OUTPUTS = ("electrons", "class", "instance", "distance")
LIGHT = Quality(16, 16, 16, 2, target=None, denoise=False)
RENDER = """
import json
from test_backends import rendered, variant_name
images = rendered({daylight})
print(json.dumps([variant_name(), {{name: image.tolist() for name, image in images.items()}}]))
"""


def rendered(daylight):
    """Images by output."""
    frame = render_scene(*plants_view(daylight=daylight), OUTPUTS, LIGHT, seed=7)
    return {name: np.asarray(frame[name]) for name in OUTPUTS}


@pytest.fixture(scope="module", params=[False, True], ids=["flash", "daylight"])
def daylight(request):
    return request.param


@pytest.fixture(scope="module")
def here(daylight):
    return rendered(daylight)


@pytest.fixture(params=VARIANTS)
def elsewhere(request, daylight, here):
    """Images of one variant in another process, and whether it is the variant of this one."""
    try:
        choose_variant(request.param)
    except SetupError as error:
        pytest.skip(str(error))
    name, images = run_python(RENDER.format(daylight=daylight), PEPPERSCENE_VARIANT=request.param)
    assert name == request.param
    images = {output: np.array(image, here[output].dtype) for output, image in images.items()}
    return images, name == variant_name()


def test_variants_agree(here, elsewhere):
    images, is_same = elsewhere
    if is_same:
        for name in OUTPUTS:
            np.testing.assert_array_equal(images[name], here[name])
        return
    for name in ("class", "instance"):
        assert (images[name] != here[name]).mean() < 1e-3, name
    assert (~np.isclose(images["distance"], here["distance"], rtol=1e-4, atol=0.0)).mean() < 1e-3
    difference = np.abs(images["electrons"] - here["electrons"]) / here["electrons"].mean()
    assert np.quantile(difference, 0.9) < 1e-3
    means = [image.reshape(-1, 3).mean(axis=0) for image in (images["electrons"], here["electrons"])]
    np.testing.assert_allclose(*means, rtol=2e-3)
