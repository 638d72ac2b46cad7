"""Labelled images as torch data sets; imported only on demand, since importing torch takes seconds."""

from __future__ import annotations

import importlib
import operator
import random  # noqa: TID251 - only its state is set, for the functions of users
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
import torch
from numpy.typing import NDArray

from pepperscene.classes import RIPE_FROM, OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame, class_mask, mask_selection, numbers_by_class
from pepperscene.dataset.readers.image_set import ARRAYS, ImageSet
from pepperscene.dataset.readers.open import RenderedSet
from pepperscene.dataset.readers.torch_augment import Augmentation
from pepperscene.dataset.readers.torch_augment_steps import ARRAY_KEYS
from pepperscene.dataset.selection import Selection, parse_categories
from pepperscene.dataset.store.recorded_values import fruit_name
from pepperscene.errors import ArgumentError, InputError, SetupError

TENSORS: Final = ("auto", "plain", "tv")
"""Allowed values of the argument `tensors`."""


@dataclass(frozen=True)
class TensorTypes:
    """The types of the tensors of samples.

    Attributes:
        name: "plain" for `torch.Tensor`, or "tv" for its subclasses in `torchvision.tv_tensors`, by which
            `torchvision.transforms.v2` knows images, masks and boxes.
    """

    name: str

    def image(self, tensor: torch.Tensor) -> torch.Tensor:
        """An image `(3, h, w)`."""
        return _tv_tensors().Image(tensor) if self.name == "tv" else tensor

    def mask(self, tensor: torch.Tensor) -> torch.Tensor:
        """One value for each pixel `(h, w)`, or one mask for each object `(n, h, w)`."""
        return _tv_tensors().Mask(tensor) if self.name == "tv" else tensor

    def boxes(self, tensor: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
        """Boxes `(n, 4)`, as left, top, right, bottom, in an image of this height and width."""
        if self.name == "plain":
            return tensor
        return _tv_tensors().BoundingBoxes(tensor, format="XYXY", canvas_size=size)


def choose_tensors(tensors: str) -> TensorTypes:
    """The tensor types of an argument: "auto", "plain" or "tv".

    Raises:
        ArgumentError: another value.
        SetupError: "tv", and torchvision cannot be imported.
    """
    if tensors not in TENSORS:
        raise ArgumentError("tensors", f"must be {', '.join(TENSORS)}, not {tensors!r}")
    if tensors == "plain":
        return TensorTypes("plain")
    try:
        _tv_tensors()
    # A torchvision of another build than torch fails with one of these, and with others in future.
    except Exception as error:
        if tensors == "auto":
            return TensorTypes("plain")
        lines = str(error).splitlines() or [type(error).__name__]
        problem = f"torchvision.tv_tensors cannot be imported ({lines[0]})"
        remedy = "install a torchvision of the same build as torch, or use tensors='plain'"
        raise SetupError(f"{problem}; {remedy}") from None
    return TensorTypes("tv")


def _tv_tensors() -> Any:
    return importlib.import_module("torchvision.tv_tensors")


@dataclass(frozen=True, eq=False)
class MaskClasses:
    """The classes of masks, in the order of their values."""

    selection: Selection  # from `mask_selection`

    @classmethod
    def parse(cls, images: ImageSet, classes: str | None, ripe_from: float | None) -> MaskClasses:
        """Read a mapping of classes for a set of images.

        Args:
            images: a set; only data sets of this package know the ripeness of fruit.
            classes: as `--classes` of `pepperscene export --format semantic`; see `parse_categories`.
                None for all organ classes.
            ripe_from: least ripeness of ripe fruit, as of `export_dataset`.

        Raises:
            ArgumentError: the mapping or the ripeness is not valid, or the set knows no ripeness.
        """
        if ripe_from is not None and not 0 <= ripe_from <= 1:
            raise ArgumentError("ripe_from", f"{ripe_from:g} must be 0 to 1")
        is_rendered = isinstance(images, RenderedSet)
        crop = fruit_name(images.dataset.info) if isinstance(images, RenderedSet) else "pepper"
        categories = parse_categories(classes, ripe_from, crop, background=True)
        chosen = Selection(categories, ripe_from=RIPE_FROM if ripe_from is None else ripe_from)
        if chosen.is_divided and not is_rendered:
            problem = f"{images.name} does not know the ripeness of fruit, only data sets of this package do"
            raise ArgumentError("classes", problem)
        return cls(mask_selection(chosen))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the classes, by mask value."""
        return tuple(category.name for category in self.selection.categories)

    def mask(self, images: ImageSet, position: int, class_ids: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`(h, w)` the class values of the image at a position, by its class image; 255 for pixels to ignore.

        Raises:
            InputError: a frame lacks an output that its ripe and unripe fruit need.
        """
        if not isinstance(images, RenderedSet) or not self.selection.is_divided:
            return numbers_by_class(self.selection)[class_ids]
        frame = DatasetFrame(images.dataset, images.items[position])
        for output in ("instance", "harvest"):
            if output not in frame.metadata["outputs"]:
                problem = f"has no output {output!r}, which ripe and unripe fruit need"
                raise InputError(images.dataset.frame_path(frame.index), problem)
        return class_mask(frame, self.selection)


FIELDS: Final[Mapping[str, str]] = dict(zip(ARRAY_KEYS, ARRAYS, strict=True))
"""Field of `LabelledImage` by key of a sample."""


@dataclass(frozen=True)
class SampleOptions:
    """How samples are made, for all torch data sets; see `torch_images`."""

    augmentation: Augmentation | None
    transform: Callable[..., Any] | None
    dtype: str
    tensors: TensorTypes
    seed: int | None


@contextmanager
def _global_seeds(seed: int) -> Iterator[None]:
    """Seed torch (CPU), NumPy's global generator and `random`; afterwards they are as they were before."""
    numpy_state = np.random.get_state()  # noqa: NPY002 - transforms of users may use it
    torch_state, python_state = torch.get_rng_state(), random.getstate()
    try:
        # `torch.manual_seed` would also start CUDA, which forked workers cannot.
        torch.default_generator.manual_seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002, TID251
        random.seed(seed)
        yield
    finally:
        torch.set_rng_state(torch_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)


class TorchSet(torch.utils.data.Dataset):
    """A map-style data set, which the workers of a `DataLoader` read in parallel.

    Nothing is kept between samples, so that memory does not grow.
    """

    missing_hint: str
    """End of the message about an image without one of the keys."""

    def __init__(self, images: ImageSet, keys: tuple[str, ...], options: SampleOptions) -> None:
        self.images = images.select(*(FIELDS[key] for key in keys))
        self.keys, self.options = keys, options
        # In shared memory, where workers that stay alive between epochs (persistent_workers) see it.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __len__(self) -> int:
        return len(self.images)

    def __repr__(self) -> str:
        kind = "tv_tensors of torchvision" if self.options.tensors.name == "tv" else "plain tensors"
        name = type(self).__name__
        return f"<{name} {self.images.name}: {len(self)} images, {', '.join(self.keys)}, as {kind}>"

    @property
    def tensors(self) -> str:
        """The type of the tensors: "plain", or "tv" for those of `torchvision.tv_tensors`."""
        return self.options.tensors.name

    @property
    def epoch(self) -> int:
        """The number given to `set_epoch`, at first 0."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Change the random numbers of a data set with a seed; call it before each epoch.

        Workers that stay alive between epochs notice it, too.

        Args:
            epoch: 0 or more.

        Raises:
            ArgumentError: the number is no integer, or below 0.
        """
        if not isinstance(epoch, int | np.integer) or epoch < 0:
            raise ArgumentError("epoch", f"must be an integer from 0, not {epoch!r}")
        self._epoch.fill_(int(epoch))

    def _targets(self, position: int, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The arrays as targets of training, before they are augmented."""
        return arrays

    @abstractmethod
    def _parts(self, position: int, name: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, ...]:
        """The arguments of the transform, which are the sample if there is none."""

    def __getitem__(self, position: int) -> Any:
        """The sample at a position, read from its files, augmented and transformed."""
        image = self.images[position]
        position = operator.index(position) % len(self)
        arrays = {key: getattr(image, FIELDS[key]) for key in self.keys}
        for key, array in arrays.items():
            if array is None:
                raise InputError(self.images.name, f"{image.name} has no {key}{self.missing_hint}")
        arrays = self._targets(position, arrays)
        rng, seeds = self._random_numbers(position)
        if self.options.augmentation is not None:
            arrays = dict(self.options.augmentation.apply(arrays, rng))
        parts = self._parts(position, image.name, arrays)
        if self.options.transform is not None:
            with seeds:
                return self.options.transform(*parts)
        return parts if len(parts) > 1 else parts[0]

    def _random_numbers(self, position: int) -> tuple[np.random.Generator, AbstractContextManager[None]]:
        """The generator of the augmentation, and a context with the seeds of the transform."""
        if self.options.seed is not None:
            # A `DataLoader` distributes samples to workers, whose number and order must not matter.
            sequence = np.random.SeedSequence([self.options.seed, self.epoch, position])
            ours, users = sequence.spawn(2)
            return np.random.default_rng(ours), _global_seeds(int(users.generate_state(1, np.uint64)[0]))
        # A `DataLoader` seeds torch's generator differently in each worker and epoch.
        drawn = int(torch.randint(2**62, ())) if self.options.augmentation else 0
        return np.random.default_rng(drawn), nullcontext()

    def _image(self, image: NDArray[np.uint8]) -> torch.Tensor:
        # A copy in any case: arrays may be mirrored views, which torch does not take.
        tensor = torch.from_numpy(image.transpose(2, 0, 1).copy())
        if self.options.dtype == "float32":
            tensor = tensor.to(torch.float32).div_(255.0)
        return self.options.tensors.image(tensor)


@final
class TorchImages(TorchSet):
    """Samples are dictionaries of tensors for each pixel; see `torch_images`."""

    missing_hint = ": leave it out of keys"

    def __init__(
        self, images: ImageSet, keys: tuple[str, ...], options: SampleOptions, mapping: MaskClasses | None
    ) -> None:
        super().__init__(images, keys, options)
        self.mapping = mapping

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes by their value in `mask`."""
        if self.mapping is None:
            return tuple(organ_class.name.lower() for organ_class in OrganClass)
        return self.mapping.names

    def _targets(self, position: int, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        if self.mapping is None or "mask" not in arrays:
            return arrays
        return {**arrays, "mask": self.mapping.mask(self.images, position, arrays["mask"])}

    def _parts(self, position: int, name: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, ...]:
        sample: dict[str, Any] = {"name": name}
        for key in self.keys:
            values = arrays[key]
            if key == "image":
                sample[key] = self._image(values)
                continue
            # torch uses int64 for indices, and supports hardly any operation on uint16.
            values = values.copy() if values.dtype.kind == "f" else values.astype("int64")
            sample[key] = self.options.tensors.mask(torch.from_numpy(values))
        return (sample,)


@final
class TorchDetections(TorchSet):
    """Samples are pairs of an image and the targets of a detector; see `torch_detections`."""

    missing_hint = ", which detections need"

    def __init__(
        self,
        images: ImageSet,
        options: SampleOptions,
        classes: tuple[int, ...],  # ids of the classes of the labels 1, 2, ...
        min_pixels: int,
    ) -> None:
        super().__init__(images, ("image", "mask", "instances"), options)
        self.classes, self.min_pixels = classes, min_pixels

    def _parts(self, position: int, name: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, ...]:
        found = find_objects(arrays["mask"], arrays["instances"], self.classes, self.min_pixels)
        tensors, size = self.options.tensors, found.masks.shape[1:]
        target = {
            "boxes": tensors.boxes(torch.from_numpy(found.boxes), (size[0], size[1])),
            "labels": torch.from_numpy(found.labels),
            "masks": tensors.mask(torch.from_numpy(found.masks)),
            "image_id": position,
            "area": torch.from_numpy(found.pixels.astype(np.float32)),
            "iscrowd": torch.zeros(len(found.labels), dtype=torch.int64),
        }
        return self._image(arrays["image"]), target


@dataclass(frozen=True, eq=False)
class DetectionObjects:
    """The n objects of an image of h x w pixels, by label and instance number.

    Attributes:
        boxes: `(n, 4)` float32: left, top, right and bottom edge, in pixels from the image's corner.
        labels: `(n,)` int64, from 1.
        masks: `(n, h, w)` uint8, 1 inside.
        pixels: `(n,)` int64, the number of pixels of each mask.
    """

    boxes: NDArray[np.float32]
    labels: NDArray[np.int64]
    masks: NDArray[np.uint8]
    pixels: NDArray[np.int64]


def find_objects(
    classes: NDArray[np.integer[Any]],
    instances: NDArray[np.integer[Any]],
    class_ids: Sequence[int],
    min_pixels: int,
) -> DetectionObjects:
    """The visible objects of some classes.

    An object is all pixels of one instance number and one class, so that labels agree with both images even
    where these do not agree with each other.

    Args:
        classes: `(h, w)` class ids.
        instances: `(h, w)` instance numbers, 0 for none.
        class_ids: the classes of the labels 1, 2, ...
        min_pixels: objects with fewer pixels are left out.
    """
    from scipy import ndimage

    numbered = np.zeros(instances.shape, np.int32)
    labels: list[int] = []
    pixels: list[int] = []
    for label, class_id in enumerate(class_ids, 1):
        inside = (classes == class_id) & (instances > 0)
        values = instances[inside]
        counts = np.bincount(values, minlength=1)
        found = np.flatnonzero(counts >= min_pixels)
        number_of = np.zeros(len(counts), np.int32)
        number_of[found] = np.arange(len(found)) + len(labels) + 1
        numbered[inside] = number_of[values]
        labels += [label] * len(found)
        pixels += counts[found].tolist()
    places = ndimage.find_objects(numbered, len(labels))
    masks = np.zeros((len(labels), *instances.shape), np.uint8)
    for number, place in enumerate(places, 1):
        masks[number - 1][place] = numbered[place] == number
    boxes = [(columns.start, rows.start, columns.stop, rows.stop) for rows, columns in places]
    return DetectionObjects(
        np.array(boxes, np.float32).reshape(-1, 4),
        np.array(labels, np.int64),
        masks,
        np.array(pixels, np.int64),
    )
