"""Groups of frames for formats of one scene: the frames that show the same plants, unchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.export.job import ExportJob
from pepperscene.recipe.plan import FrameSpec, Plan


def scene_groups(job: ExportJob) -> dict[str, tuple[int, ...]]:
    """The frames of each scene by the name of its folder, which is "." if there is only one.

    A scene is a rotation of a set of plants. Twins, whose images differ in light or camera, are scenes of
    their own.
    """
    plan, names = _plan(job), {}
    for index in job.split_of:
        names[index] = _scene_name(plan, plan.frame(index))
    return _grouped(names)


def sequence_groups(job: ExportJob) -> dict[str, tuple[int, ...]]:
    """As `scene_groups`, for the frames of one split and one camera of a rig."""
    plan, names = _plan(job), {}
    for index, split in job.split_of.items():
        spec = plan.frame(index)
        camera = f"_camera_{spec.camera}" if plan.cameras > 1 else ""
        names[index] = f"{split}/{_scene_name(plan, spec)}{camera}"
    if len(job.splits) == 1:
        names = {index: name.partition("/")[2] for index, name in names.items()}
    elif all(len({names[index] for index in members}) == 1 for members in job.splits.values()):
        # One sequence in each split.
        names = dict(job.split_of)
    return _grouped(names)


def open_groups(
    job: ExportJob, folder: Path, groups: Mapping[str, Sequence[int]]
) -> Iterator[tuple[Path, Sequence[int], Iterator[DatasetFrame]]]:
    """The folder of each group, which is made, its indices, and its frames, which must all be read."""
    for name, frames in job.frames_by_group(groups):
        (folder / name).mkdir(parents=True, exist_ok=True)
        yield folder / name, groups[name], frames


def scene_splits(job: ExportJob, indices: Sequence[int]) -> dict[str, list[int]]:
    """The splits of the frames of a scene, as readers want them; none if all frames of the export are in one.

    Readers that find the list of any split need those of `train`, `val` and `test`. A missing one is that of
    another split.
    """
    if len(job.splits) == 1:
        return {}
    members = {split: [i for i in indices if job.split_of[i] == split] for split in job.splits}
    members = {split: found for split, found in members.items() if found}
    first = next(iter(members))
    for name, substitute in (("train", first), ("val", "test"), ("test", "val")):
        members.setdefault(name, members.get(substitute, members[first]))
    return members


def training_frames(job: ExportJob, indices: Sequence[int]) -> list[DatasetFrame]:
    """Those of a scene's frames that training may use: of the split `train`, or all if it has none."""
    indices = scene_splits(job, indices).get("train", indices)
    return [DatasetFrame(job.dataset, index) for index in indices]


def _plan(job: ExportJob) -> Plan:
    return Plan.model_validate(job.dataset.info["recipe"]["plan"])


def _scene_name(plan: Plan, spec: FrameSpec) -> str:
    twin = f"_twin_{spec.twin}" if plan.twins > 1 else ""
    return f"set_{spec.set:03d}_rotation_{spec.rotation:03d}{twin}"


def _grouped(names: Mapping[int, str]) -> dict[str, tuple[int, ...]]:
    groups: dict[str, list[int]] = {}
    for index, name in names.items():
        groups.setdefault(name, []).append(index)
    if len(groups) == 1:
        return {".": tuple(names)}
    return {name: tuple(members) for name, members in groups.items()}
