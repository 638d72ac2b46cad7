"""Colours matched to photographs: moments and histograms after the match, and trainings with it."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.color import rgb2lab
from skimage.exposure import cumulative_distribution
from toy_models import image_set, random_masks

from pepperscene.errors import InputError

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")

from pepperscene.learning.options import TrainingOptions  # noqa: E402
from pepperscene.learning.training import train  # noqa: E402
from pepperscene.learning.training.colour_matching import MATCHES, ColourMatching  # noqa: E402


def picture(mean, spread, seed, size=(40, 50)):
    """Correlated random colours `(h, w, 3)`, far from black and white."""
    rng = np.random.default_rng(seed)
    mixing = np.eye(3) + 0.4 * rng.random((3, 3))
    return np.clip(mean + spread * rng.normal(size=(*size, 3)) @ mixing, 20, 235).astype(np.uint8)


IMAGE, PHOTO = picture((90, 120, 70), 9, seed=1), picture((130, 110, 120), 12, seed=2, size=(30, 60))


def test_statistics_of_cielab_are_those_of_the_photograph():
    matched = rgb2lab(np.clip(MATCHES["statistics"](IMAGE, PHOTO) / 255, 0, 1))
    target = rgb2lab(PHOTO)
    np.testing.assert_allclose(matched.mean((0, 1)), target.mean((0, 1)), atol=0.05)
    np.testing.assert_allclose(matched.std((0, 1)), target.std((0, 1)), rtol=0.01)


def test_transport_gives_mean_and_covariance_and_moves_colours_least():
    matched = MATCHES["transport"](IMAGE, PHOTO).reshape(-1, 3)
    target = PHOTO.reshape(-1, 3).astype(float)
    np.testing.assert_allclose(matched.mean(0), target.mean(0), atol=1e-6)
    np.testing.assert_allclose(np.cov(matched.T), np.cov(target.T), rtol=1e-4)
    # The optimal map between normal distributions is the gradient of a convex function: symmetric, positive.
    source = IMAGE.reshape(-1, 3) - IMAGE.reshape(-1, 3).mean(0)
    linear = np.linalg.lstsq(source, matched - matched.mean(0), rcond=None)[0].T
    np.testing.assert_allclose(linear, linear.T, atol=1e-6)
    assert np.linalg.eigvalsh(linear).min() > 0


def test_histograms_are_those_of_the_photograph():
    matched = np.rint(MATCHES["histogram"](IMAGE, PHOTO)).astype(np.uint8)
    for channel in range(3):
        codes = np.arange(256)
        shares = []
        for image in (matched, PHOTO):
            values, centres = cumulative_distribution(image[..., channel])
            shares.append(np.interp(codes, centres, values, left=0))
        assert np.abs(shares[0] - shares[1]).max() < 0.06


@pytest.mark.parametrize("kind", MATCHES)
def test_an_image_of_its_own_colours_and_a_grey_one_stay_finite(kind):
    same = MATCHES[kind](IMAGE, IMAGE)
    np.testing.assert_allclose(same, IMAGE, atol=0.6)
    grey = np.full_like(IMAGE, 90)
    assert np.isfinite(MATCHES[kind](grey, PHOTO)).all()


def test_matches_depend_on_the_generator_alone_and_lie_between_the_images():
    matching = ColourMatching([image_set(*random_masks(3))], "transport")
    first, again = (matching(IMAGE, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (matching(IMAGE, np.random.default_rng(5)) != first).any()
    with pytest.raises(InputError, match="no photographs"):
        ColourMatching([], "transport")


def test_trainings_record_what_they_were_matched_to(tmp_path):
    images = image_set(*random_masks(2, shape=(40, 48)))
    options = TrainingOptions(
        model="small,width=0.25", steps=2, batch=2, size=(32, 32), width=None, matching="histogram"
    )
    model = train(images, tmp_path / "matched", options, match=image_set(*random_masks(2, seed=9)))
    plain = train(images, tmp_path / "plain", options)
    assert model.training["match"][0]["images"] == 2
    assert "match" not in plain.training
    weights = [item.module.state_dict() for item in (model, plain)]
    assert any(not torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
