"""The command `visibility`."""

from __future__ import annotations

import pytest
from pyarrow import parquet

SMALL = (
    "--set", "row={plants_front=1, plants_back=0}", "--set", "cultivar=kaite_february", "--samples", 64,
)  # fmt: skip
LOW = ("--set", "views.height_mm=[400, 600]", "--set", "views.pitch_deg=0")
BOX = ("--box", "-300,300,-600,-300,600,1600")


def test_random_poses_in_a_box_and_the_next_best_views(command, tmp_path):
    out = tmp_path / "table.parquet"
    result = command("visibility", "barth2018", *SMALL, *BOX, "--random", 20, "--views", 3, "--out", out)
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("scene 0: 20 poses, 20 reachable; ")
    assert [line.split(":")[0] for line in lines[1:4]] == ["view 1", "view 2", "view 3"]
    rows = parquet.read_table(out).to_pylist()
    assert lines[4] == f"{len(rows):,} rows: {out}"
    assert {row["reachable"] for row in rows} == {True}
    for row in rows:
        assert -0.3 <= row["x_m"] <= 0.3
        assert -0.6 <= row["y_m"] <= -0.3
        assert 0.6 <= row["z_m"] <= 1.6
    taken = {row["view"]: row["pose"] for row in rows if row["view"]}
    assert [f"pose {taken[number]} at" in lines[number] for number in (1, 2, 3)] == [True] * 3
    again = tmp_path / "again.parquet"
    command("visibility", "barth2018", *SMALL, *BOX, "--random", 20, "--views", 3, "--out", again)
    assert again.read_bytes() == out.read_bytes()
    command("visibility", "barth2018", *SMALL, *BOX, "--random", 20, "--seed", 1, "--out", again)
    assert again.read_bytes() != out.read_bytes()


def test_frames_are_observed_without_other_poses(command, tmp_path):
    out = tmp_path / "table.parquet"
    result = command(
        "visibility", "barth2018", *SMALL, "--frames", "40:43", "--no-occluders", *LOW, "--out", out
    )
    assert result.exit_code == 0, result.stderr
    rows = parquet.read_table(out).to_pylist()
    assert {row["frame"] for row in rows} == {40, 41, 42}
    assert {row["occluder_instances"] for row in rows} == {None}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--out", "table.csv"), "error: --out: 'table.csv' must end in .parquet"),
        (("--out", "t.parquet", "--random", 5), "error: --random: needs a workspace: a box or a sphere"),
        (("--out", "t.parquet", "--box", "1,2"), "--box: must be 6 numbers separated by commas, not '1,2'"),
        (("--out", "t.parquet", *BOX, "--sphere", "0,0,1,1"), "--sphere: cannot be combined with box"),
        (("--out", "t.parquet", "--samples", 100), "--samples: must be a multiple of 64 above 0, not 100"),
        (("--out", "t.parquet", "--views", 2, "--frames", "0:1", "--poses", "no.csv"), "no.csv"),
    ],
)
def test_invalid_options_give_one_line_and_no_file(rejects, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    rejects(message, "visibility", "barth2018", *SMALL, *options)
    assert list(tmp_path.iterdir()) == []
