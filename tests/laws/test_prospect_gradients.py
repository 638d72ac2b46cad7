"""PROSPECT on torch tensors: the same numbers, and gradients in every parameter."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from pepperscene.spectra import absorption_coefficients, layer_over_body, leaf_spectra
from pepperscene.spectra.plates import cone_transmissivity, floats, pile, plate, slab_transmission

torch = pytest.importorskip("torch", reason="gradients need the optional package torch (extra `tuning`)")

NM = np.array([420.0, 470.0, 550.0, 600.0, 680.0, 720.0, 800.0, 1450.0])
LEAF = {
    "structure_n": (1.0, 3.5),
    "chlorophyll_ug_cm2": (0.0, 80.0),
    "carotenoid_ug_cm2": (0.0, 20.0),
    "anthocyanin_ug_cm2": (0.0, 10.0),
    "capsanthin_ug_cm2": (0.0, 20.0),
    "brown": (0.0, 1.0),
    "water_cm": (0.0, 0.05),
    "dry_matter_g_cm2": (0.0, 0.02),
}
PRO = {k: v for k, v in LEAF.items() if k != "dry_matter_g_cm2"} | {
    "protein_g_cm2": (0.0, 0.003),
    "carbon_g_cm2": (0.0, 0.02),
}
BODY = {"flesh": (0.0, 0.99), "ior": (1.0, 1.6)}


def spectra(parameters):
    """All that a leaf or fruit shows, `(leaves, 7, wavelengths)`, by the parameters' names."""
    contents = {k: v for k, v in parameters.items() if k not in BODY}
    leaf = leaf_spectra(NM, **contents)
    skin = layer_over_body(leaf, parameters["flesh"][:, None])
    shown = (
        leaf.reflectance, leaf.transmittance, leaf.diffuse_reflectance, leaf.diffuse_transmittance,
        skin.reflectance, *leaf.under_cuticle(parameters["ior"]), skin.under_cuticle(parameters["ior"])[0],
    )  # fmt: skip
    stack = torch.stack if isinstance(shown[0], torch.Tensor) else np.stack
    return stack(shown, 1)


def draw(ranges, leaves, seed=0):
    """Random leaves, a hundredth of each range away from its ends."""
    rng = np.random.default_rng(seed)
    return {k: a + (b - a) * rng.uniform(0.01, 0.99, leaves) for k, (a, b) in (ranges | BODY).items()}


def tensors(parameters):
    return {k: torch.tensor(v, dtype=torch.float64, requires_grad=True) for k, v in parameters.items()}


@pytest.mark.parametrize("ranges", [LEAF, PRO], ids=["D", "PRO"])
def test_tensors_give_the_numbers_of_arrays(ranges):
    parameters = draw(ranges, 100)
    arrays = spectra(parameters)
    assert arrays.dtype == np.float64
    found = spectra(tensors(parameters))
    assert found.dtype == torch.float64
    assert found.detach().numpy() == pytest.approx(arrays, abs=1e-12)


@pytest.mark.parametrize("ranges", [LEAF, PRO], ids=["D", "PRO"])
def test_gradients_are_those_of_finite_differences(ranges):
    """Central differences in NumPy, over 30 leaves, all parameters, outputs and wavelengths.

    The error of a central difference with a step of 1e-5 of the range is some 1e-10 of the function's third
    derivative in the range's unit, and its rounding 1e-11: the largest seen is 2e-8, for slopes up to 3.
    """
    parameters = draw(ranges, 30)
    given = tensors(parameters)
    outputs = spectra(given).reshape(30, -1)
    # A leaf depends on its own parameters alone: the gradient of the sum over leaves holds all of them.
    rows = [
        torch.autograd.grad(column.sum(), list(given.values()), retain_graph=True) for column in outputs.T
    ]
    for i, (name, values) in enumerate(parameters.items()):
        low, high = (ranges | BODY)[name]
        step = 1e-5 * (high - low)
        above, below = (spectra(parameters | {name: values + d}).reshape(30, -1) for d in (step, -step))
        slope = np.stack([row[i].numpy() for row in rows], 1)
        assert slope * (high - low) == pytest.approx((above - below) / 2e-5, abs=1e-7), name


@pytest.mark.filterwarnings(
    "ignore:`torch.jit.script` is deprecated:DeprecationWarning"
)  # within torch itself
def test_reverse_and_forward_mode_and_second_derivatives():
    names = ("structure_n", "chlorophyll_ug_cm2", "water_cm")

    def reflectance(*values):
        return leaf_spectra(NM[::2], **dict(zip(names, values, strict=True))).reflectance

    leaves = [
        torch.tensor(v, dtype=torch.float64, requires_grad=True)
        for v in ([1.3, 2.4], [5.0, 40.0], [0.01, 0.03])
    ]
    assert torch.autograd.gradcheck(reflectance, leaves, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(reflectance, leaves)
    jacobian = torch.func.jacfwd(reflectance, argnums=1)(*(x.detach() for x in leaves))
    assert jacobian.shape == (2, 4, 2)
    assert torch.equal(jacobian[0, :, 1], torch.zeros(4, dtype=torch.float64))


@pytest.mark.parametrize("plates", [1.0, 1.0 + 1e-12, 2.5])
@pytest.mark.parametrize("name", [k for k in LEAF if k != "structure_n"])
def test_gradients_at_no_pigment_at_all(name, plates):
    """Tissue that absorbs nothing: the formulas' 0/0 has a limit, and so has its slope."""
    given = tensors({k: np.zeros(1) for k in LEAF} | {"structure_n": np.array([plates])})
    leaf = leaf_spectra(NM, **given)
    unit = {"dry_matter_g_cm2": "dry_matter", "water_cm": "water"}.get(name, name.removesuffix("_ug_cm2"))
    strongest = absorption_coefficients(NM)[unit].max()
    # One-sided, over a step that absorbs 1e-8 at most: the slope changes as k log k.
    step = 1e-8 / strongest
    there = leaf_spectra(NM, structure_n=[plates], **{name: step})
    for shown in ("reflectance", "transmittance", "diffuse_reflectance", "diffuse_transmittance"):
        here = getattr(leaf, shown)[0]
        slopes = [torch.autograd.grad(x, given[name], retain_graph=True)[0].item() for x in here]
        expected = (getattr(there, shown)[0] - here.detach().numpy()) / step
        assert np.array(slopes) == pytest.approx(expected, abs=1e-5 * strongest), shown


@pytest.mark.parametrize("plates", [1.0, 1.7, 1e6])
@pytest.mark.parametrize(
    "absorbance", [0.0, 5e-324, 1e-300, 1e-17, 1e-12, 1e-6, 1e-2, 1.0, 30.0, 800.0, 1e4, 1e300]
)
def test_gradients_are_finite_everywhere(absorbance, plates):
    k, n, count = (
        torch.tensor([x], dtype=torch.float64, requires_grad=True) for x in (absorbance, 1.45, plates)
    )
    for shown in pile(*plate(k, n), count):
        assert torch.isfinite(shown).all()
        for slope in torch.autograd.grad(shown, [k, n, count], retain_graph=True):
            assert torch.isfinite(slope).all()


@pytest.mark.parametrize("plates", [1.0, 1.7, 4.0])
def test_gradients_have_no_step_where_series_meet_closed_forms(plates):
    """Over fine steps of absorbance across every switch, the slope follows the values."""
    k = np.geomspace(1e-7, 0.1, 8001)
    tensor = torch.tensor(k, requires_grad=True)
    for shown in pile(*plate(tensor, 1.45), plates):
        (slope,) = torch.autograd.grad(shown.sum(), tensor, retain_graph=True)
        # The trapezoid over steps of 0.2 % misses less than 1e-6 of each increment.
        steps = np.diff(shown.detach().numpy())
        expected = (slope.numpy()[1:] + slope.numpy()[:-1]) / 2 * np.diff(k)
        assert steps == pytest.approx(expected, rel=2e-6, abs=1e-14)


def test_gradients_at_the_edges_of_the_surface():
    """A cuticle of index 1 has no gloss and no slope of it; black and nearly white flesh are smooth."""
    ior = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    gloss = 1.0 - cone_transmissivity(np.radians(40), ior)
    assert gloss.item() == 0.0
    assert torch.autograd.grad(gloss, ior)[0].item() == pytest.approx(0.0, abs=1e-12)
    flesh = torch.tensor([0.0, 0.5, 1.0 - 1e-9], dtype=torch.float64, requires_grad=True)
    shown = layer_over_body(leaf_spectra(NM, structure_n=1.0), flesh[:, None]).under_cuticle(1.45)[0]
    assert torch.isfinite(torch.autograd.grad(shown.sum(), flesh)[0]).all()


def test_a_slab_has_the_slope_of_the_next_integral():
    """d/dk 2 E3(k) = -2 E2(k), which is -2 where nothing is absorbed."""
    from scipy.special import expn

    k = torch.tensor([0.0, 1e-9, 0.3, 5.0, 200.0], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(slab_transmission(k).sum(), k)
    assert slope.numpy() == pytest.approx(-2.0 * expn(2, k.detach().numpy()), rel=1e-14)


def test_a_leaf_is_found_again_from_its_spectrum():
    """What the gradients are for: contents fitted to a reflectance and a transmittance, from a poor start."""
    names, scale = list(LEAF)[:4], torch.tensor([1.0, 40.0, 10.0, 2.0], dtype=torch.float64)
    nm = np.arange(420.0, 801.0, 10.0)
    true = torch.tensor([1.62, 43.0, 10.5, 1.3], dtype=torch.float64)

    def shown(contents):
        leaf = leaf_spectra(nm, **dict(zip(names, contents, strict=True)), water_cm=0.01)
        return torch.cat([leaf.reflectance, leaf.transmittance])

    target = shown(true)
    # Logarithms keep the contents positive, and plates above one.
    start = torch.tensor([0.2, 0.3, 0.3, 0.3], dtype=torch.float64, requires_grad=True)
    lowest = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    optimiser = torch.optim.LBFGS([start], max_iter=200, tolerance_grad=1e-12, tolerance_change=1e-14,
                                  line_search_fn="strong_wolfe")  # fmt: skip

    def loss():
        optimiser.zero_grad()
        error = ((shown(lowest + scale * start.abs()) - target) ** 2).sum()
        error.backward()
        return error

    optimiser.step(loss)
    found = (lowest + scale * start.abs()).detach().numpy()
    assert found == pytest.approx(true.numpy(), rel=1e-3)


def test_numbers_and_single_precision_become_double_precision_tensors():
    single = torch.tensor([1.5], dtype=torch.float32, requires_grad=True)
    xp, (a, b, c) = floats(single, 2, np.array([1, 2]))
    assert xp is torch
    assert {x.dtype for x in (a, b, c)} == {torch.float64}
    a.sum().backward()
    assert single.grad.item() == 1.0


def test_torch_is_not_imported_for_arrays():
    code = (
        "import sys\n"
        "from pepperscene.spectra import leaf_spectra, over_body\n"
        "over_body(leaf_spectra([500.0], structure_n=1.5), 0.5).under_cuticle(1.4)\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
