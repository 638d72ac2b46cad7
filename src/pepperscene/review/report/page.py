"""The page as HTML: templates escape all data, so that a data set adds no element, attribute or script."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import lru_cache
from importlib import resources
from typing import Any, Final

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.review.report.colours import VIRIDIS

_PACKAGE: Final = "pepperscene.review.report"


def render(template: str, /, **context: Any) -> str:
    """A template of this package with the values of its names; all texts in them are escaped."""
    return _environment().get_template(template).render(context)


def html_environment(package: str) -> Environment:
    """Templates of a package, which escape all texts and may extend `base.html` of this one."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(_PACKAGE)]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters["csp_hash"] = csp_hash
    return environment


@lru_cache(maxsize=1)
def _environment() -> Environment:
    environment = html_environment(_PACKAGE)
    environment.filters.update(percent=format_percent, plural=plural, css=_css, code=_code)
    environment.globals["classes"] = tuple(OrganClass)
    return environment


def page_style() -> Markup:
    """The style sheet of the page."""
    return Markup(_read("page.css").replace("$ramp", ", ".join(VIRIDIS)))


def page_script(names: Sequence[str]) -> Markup:
    """Some of the page's scripts as one."""
    return Markup("\n".join(map(_read, names)))


def _read(name: str) -> str:
    return resources.files(_PACKAGE).joinpath("templates", name).read_text(encoding="utf-8")


def csp_hash(text: str) -> Markup:
    """Source of a content security policy that allows the script or style element with exactly this text.

    A hash, unlike 'unsafe-inline', does not allow any other script, event handler or style attribute.
    """
    return Markup(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'")


def format_percent(fraction: float, digits: int = 2) -> str:
    """A fraction as a percentage; a dash if it is unknown."""
    if not np.isfinite(fraction):
        return "–"
    smallest = 10.0**-digits
    is_small = 0 < 100 * fraction < smallest / 2
    return f"< {smallest:g}\u00a0%" if is_small else f"{100 * fraction:.{digits}f}\u00a0%"


def plural(count: int, noun: str) -> str:
    """A count with its noun."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def _css(colour: OrganClass | tuple[int, int, int]) -> str:
    """An 8-bit RGB colour, or that of a class, in CSS."""
    return f"#{_code(colour):06x}"


def _code(colour: OrganClass | tuple[int, int, int]) -> int:
    """An 8-bit RGB colour, or that of a class, as 0xRRGGBB."""
    red, green, blue = CLASS_COLOURS[colour] if isinstance(colour, OrganClass) else colour
    return red << 16 | green << 8 | blue
