"""Photometric files of lamps, IES LM-63 and EULUMDAT: in the styles of makers, cut, and wrong."""

import numpy as np
import pytest

from pepperscene.camera.lamps.lamp_files import load_lamp
from pepperscene.camera.lamps.photometric_files import read_beam
from pepperscene.errors import InputError

ANGLES = np.arange(0.0, 181.0, 5.0)


def candela(plane_deg, angle_deg):
    """A beam that is the same in all quarters, without light above the horizon."""
    across = 1.0 + 0.5 * np.cos(2 * np.radians(plane_deg)) * np.sin(np.radians(angle_deg)) ** 2
    return 1500.0 * np.maximum(np.cos(np.radians(angle_deg)), 0.0) ** 1.5 * across


def directions(plane_deg, angle_deg):
    plane, angle = np.broadcast_arrays(np.radians(plane_deg), np.radians(angle_deg))
    return np.stack([np.sin(angle) * np.cos(plane), np.sin(angle) * np.sin(plane), np.cos(angle)], axis=-1)


def ies_text(planes, *, wrapped=10, multiplier=2.0, ballast=0.9):
    """As one maker writes them: keywords, long lists wrapped at ten numbers, values over the multiplier."""
    values = candela(planes[:, None], ANGLES) / (multiplier * ballast)
    lists = [ANGLES, planes, *values]
    rows = [
        " ".join(f"{x:.4f}" for x in one[k : k + wrapped])
        for one in lists
        for k in range(0, len(one), wrapped)
    ]
    head = [
        "IESNA:LM-63-2002", "[TEST] 1", "[MANUFAC] A maker", "[LUMCAT] X-1", "TILT=NONE",
        f"1 -1 {multiplier} {len(ANGLES)} {len(planes)} 1 2 0.1 0.2 0.0", f"{ballast} 1.0 100",
    ]  # fmt: skip
    return "\r\n".join([*head, *rows, ""])


def ldt_text(symmetry, planes, shown, *, comma=False):
    """As another maker writes them: one number a line, all planes, but only the candela of those shown."""
    lumens = 4000.0
    head = [
        "A maker", "1", str(symmetry), str(len(planes)), "15", str(len(ANGLES)), "5", "report", "lamp", "X-2",
        "x.ldt", "2020", "600", "600", "50", "500", "500", *["0"] * 4, "100", "90", "1", "0", "1",
        "1", "LED", str(lumens), "4000K", "80", "40", *["0.5"] * 10,
    ]  # fmt: skip
    values = candela(np.asarray(shown)[:, None], ANGLES) / lumens * 1000.0
    numbers = [f"{x:.4f}" for x in [*planes, *ANGLES, *values.ravel()]]
    text = "\n".join([*head, *numbers, ""])
    return text.replace(".", ",") if comma else text


TURN = np.arange(0.0, 360.0, 15.0)
FILES = {
    "quarter.ies": ies_text(np.arange(0.0, 91.0, 15.0)),
    "half.ies": ies_text(np.arange(0.0, 181.0, 15.0), wrapped=99),
    "half_from_90.ies": ies_text(np.arange(90.0, 271.0, 15.0)),
    "full.ies": ies_text(np.arange(0.0, 361.0, 15.0)),
    "full.ldt": ldt_text(0, TURN, TURN),
    "half.ldt": ldt_text(2, TURN, np.arange(0.0, 181.0, 15.0), comma=True),
    "half_from_270.ldt": ldt_text(3, TURN, np.arange(270.0, 451.0, 15.0)),
    "quarter.ldt": ldt_text(4, TURN, np.arange(0.0, 91.0, 15.0)),
}


@pytest.mark.parametrize("name", FILES)
def test_beam_has_the_candela_of_its_table(tmp_path, name):
    (tmp_path / name).write_bytes(FILES[name].encode())
    beam = read_beam(tmp_path / name)
    planes, angles = np.meshgrid(TURN, ANGLES, indexing="ij")
    found = beam.at(directions(planes, angles)) * beam.flux
    np.testing.assert_allclose(found, candela(planes, angles), rtol=1e-3, atol=0.1)


def test_lamp_has_the_lumens_of_its_candela(tmp_path):
    (tmp_path / "lamp.ies").write_text(FILES["quarter.ies"])
    # 2 pi / 2.5 times the mean over the planes, and the table's straight lines.
    assert load_lamp(tmp_path / "lamp.ies").flux_lm == pytest.approx(1500.0 * 2 * np.pi / 2.5, rel=3e-3)


def test_uplight_is_dark_below(tmp_path):
    """As LM-63 has it, angles begin at 90 degrees; the lumens are those of the closed form."""
    rows = [
        "IESNA:LM-63-2002",
        "TILT=NONE",
        "1 -1 1 3 1 1 2 0 0 0",
        "1 1 50",
        "90 135 180",
        "0",
        "500 500 500",
    ]
    (tmp_path / "up.ies").write_text("\n".join(rows))
    lamp = load_lamp(tmp_path / "up.ies")
    assert lamp.flux_lm == pytest.approx(2 * np.pi * 500.0, rel=1e-5)
    found = lamp.beam.at(directions(30.0, np.array([0.0, 60.0, 89.9, 90.1, 120.0]))) * lamp.beam.flux
    np.testing.assert_allclose(found, [0.0, 0.0, 0.0, 500.0, 500.0], atol=1e-6)


def test_lamp_of_one_plane_is_round(tmp_path):
    (tmp_path / "round.ies").write_text(ies_text(np.zeros(1)))
    beam = read_beam(tmp_path / "round.ies")
    assert np.ptp(beam.at(directions(TURN, 40.0))) == 0.0


@pytest.mark.parametrize("name", ["quarter.ies", "half.ldt"])
def test_files_that_are_cut_anywhere_are_one_sentence(tmp_path, name):
    text, file = FILES[name], tmp_path / name
    for end in [*range(0, len(text) - 12, 37), len(text) - 12]:
        file.write_bytes(text[:end].encode())
        with pytest.raises(InputError) as caught:
            load_lamp(file)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("TILT=NONE", "TILT=INCLUDE", "must have TILT=NONE"),
        (" 37 7 1 2 ", " 37 7 2 2 ", "type C"),
        (" 37 7 1 2 ", " 1e9 7 1 2 ", "whole numbers"),
        ("0.0000 5.0000", "0.0000 nan", "finite number"),
        ("0.0000 5.0000", "9.0000 9.5000", "angles from 0"),
        ("0.0000 5.0000 10.0000", "0.0000 10.0000 5.0000", "must increase"),
        ("2.0 37", "-2.0 37", "at least 0"),
        ("2.0 37", "0 37", "some light"),
    ],
)
def test_wrong_numbers_are_one_sentence(tmp_path, old, new, message):
    text = FILES["quarter.ies"]
    assert old in text
    (tmp_path / "lamp.ies").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        load_lamp(tmp_path / "lamp.ies")
