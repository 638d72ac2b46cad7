"""`pepperscene export`: progress, summary and error messages."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module")
def folder(command, tmp_path_factory):
    """A data set of empty images."""
    out = tmp_path_factory.mktemp("cli") / "set"
    done = command(
        "build", "demo", "--out", out, "--frames", "6137:6140", "--outputs", "colour,class,instance,distance",
        "--set", "row.plants_front=1", "--set", "row.plants_back=0", "--set", "cultivar=kaite_february",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    return out


@pytest.mark.parametrize("form", ["published", "coco", "yolo"])
def test_export_prints_progress_and_summary(form, folder, command, tmp_path):
    out = tmp_path / form
    done = command("export", folder, "--format", form, "--out", out, "--split", "train=:6139,val=6139:")
    assert done.exit_code == 0, done.stderr
    assert done.stdout == f"3 frames as {form} (2 train, 1 val): {out}\n"
    assert done.stderr.splitlines() == [
        "frame 006137 (1 of 3)",
        "frame 006138 (2 of 3)",
        "frame 006139 (3 of 3)",
    ]
    assert any(out.iterdir())


def test_options_are_passed_on(folder, command, tmp_path):
    options = ("--format", "yolo", "--out", tmp_path / "o", "--frames", "6138:6139", "--smallest", 3)
    done = command("export", folder, *options)
    assert done.stdout == f"1 frame as yolo (1 train): {tmp_path / 'o'}\n"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"--format": "coc"}, "--format: unknown format 'coc'; allowed are published, coco, yolo"),
        ({"--split": "train=.5"}, "--split: the fractions sum to 0.5; they must be positive and sum to 1"),
        ({"--split": "a=0:10,b=9:6140"}, "--split: a and b overlap: frame 9 belongs to both"),
        ({"--frames": "0:5"}, "--frames: '0:5' holds none of the data set's frames"),
        ({"--smallest": "0"}, "--smallest: 0 must be at least 1"),
    ],
)
def test_invalid_options_give_one_line(change, message, folder, command, tmp_path):
    options = {"--format": "coco", "--out": str(tmp_path / "out")} | change
    done = command("export", folder, *(word for pair in options.items() for word in pair))
    assert done.exit_code == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert message in done.stderr
    assert not (tmp_path / "out").exists()


def test_invalid_folders_give_one_line(folder, command, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    for source, out, message in [
        (tmp_path, tmp_path / "out", "holds no data set"),
        (folder, tmp_path / "full", "holds 'mine'; choose an empty or a new folder"),
        (folder, folder / "coco", "is inside the data set"),
    ]:
        done = command("export", source, "--format", "coco", "--out", out)
        assert done.exit_code == 2
        assert len(done.stderr.splitlines()) == 1
        assert message in done.stderr
