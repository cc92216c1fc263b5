# SPDX-License-Identifier: Apache-2.0
"""What each effect does to a wheel, as a small drawing: SVG as text, which `draw.py` writes into files."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from math import cos, pi, sin

_WIDTH, _HEIGHT = 240, 130
_GROUND, _RUT = 72, 90  # heights of fresh soil and of a rut, from above
_INK = "#5a626d"  # half-dark, to be read on a dark page as well
_NEW = "#0072b2"  # what the effect adds


def drawing(effect: str) -> str:
    """The drawing of an effect as a file of SVG."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{_HEIGHT}" '
        f'font-family="sans-serif" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" '
        f'aria-label="{effect.replace("_", " ")}" fill="none" stroke="{_INK}" stroke-width="1.6" '
        f'font-size="11">{EFFECTS[effect]()}</svg>\n'
    )


def _path(d: str, colour: str = _INK, dash: str = "", width: float = 1.6) -> str:
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return f'<path d="{d}" stroke="{colour}" stroke-width="{width}"{dashed}/>'


def _text(x: float, y: float, text: str, colour: str = _INK, anchor: str = "start") -> str:
    return (f'<text x="{x}" y="{y}" fill="{colour}" stroke="none" text-anchor="{anchor}">'
            f"{escape(text)}</text>")  # fmt: skip


def _arrow(x: float, y: float, dx: float, dy: float, colour: str = _NEW) -> str:
    """An arrow from a point, with its head."""
    length = (dx * dx + dy * dy) ** 0.5
    ux, uy = 6 * dx / length, 6 * dy / length
    tip_x, tip_y = x + dx, y + dy
    head = (
        f"M{tip_x - ux - uy / 2:.1f} {tip_y - uy + ux / 2:.1f}L{tip_x:g} {tip_y:g}"
        f"L{tip_x - ux + uy / 2:.1f} {tip_y - uy - ux / 2:.1f}"
    )
    return _path(f"M{x:g} {y:g}L{tip_x:g} {tip_y:g}{head}", colour, width=2)


def _wheel(x: float, y: float, r: float = 34) -> str:
    return (f'<circle cx="{x:g}" cy="{y:g}" r="{r:g}"/>'
            f'<circle cx="{x:g}" cy="{y:g}" r="2.5" fill="{_INK}"/>')  # fmt: skip


def _soil(outline: str) -> str:
    """Soil below an outline that goes from the left edge to the right one."""
    fill = f'<path d="{outline}V{_HEIGHT}H0Z" fill="{_INK}" fill-opacity=".1" stroke="none"/>'
    return fill + _path(outline)


def _rolling(rut: float = _RUT, ground: float = _GROUND, x: float = 120, r: float = 34) -> str:
    """A wheel that rolls to the right and leaves a rut."""
    y = rut - r
    front = x + (r * r - (ground - y) ** 2) ** 0.5
    outline = f"M0 {rut}H{x}A{r} {r} 0 0 0 {front:.1f} {ground}H{_WIDTH}"
    return _soil(outline) + _wheel(x, y, r) + _arrow(x, y, 26, 0, _INK)


def _spin(x: float = 120, y: float = 56, r: float = 20) -> str:
    """A wheel's turning, clockwise."""
    a, b = -0.85 * pi, -0.2 * pi
    start = f"{x + r * cos(a):.1f} {y + r * sin(a):.1f}"
    end_x, end_y = x + r * cos(b), y + r * sin(b)
    return _path(f"M{start}A{r} {r} 0 0 1 {end_x:.1f} {end_y:.1f}", _NEW, width=2) + _arrow(
        end_x - 2, end_y - 3, 3, 6
    )


def _deeper(first: str = "without slip", then: str = "z") -> str:
    """The level without the effect, and how much deeper the wheel is with it."""
    return (_path("M8 88H104", _NEW, "4 3") + _arrow(30, 88, 0, 14) + _text(8, 84, first, _NEW)
            + _text(36, 100, then, _NEW))  # fmt: skip


def _graph(x: str, y: str, curve: str, plain: str = "M40 62H216") -> str:
    """A quantity over another: without the effect dashed, with it drawn."""
    return (
        _path("M40 12V104H222") + _path(plain, _INK, "4 3") + _path(curve, _NEW, width=2.2)
        + _text(222, 120, x, anchor="end") + _text(46, 18, y)
    )  # fmt: skip


def _instrument(quantity: str, gain: bool) -> Callable[[], str]:
    """What an instrument shows over what there is."""
    curve = "M40 104L190 18" if gain else "M40 84L182 12"
    return lambda: _graph(f"{quantity} itself", f"{quantity} shown", curve, "M40 104L216 24")


def _slip_sinkage() -> str:
    return _rolling(104, 72) + _spin(120, 70) + _deeper()


def _skid_sinkage() -> str:
    heap = _path("M150 72C158 56 172 62 184 72", _NEW, width=2)
    return _rolling(104, 72) + heap + _deeper("rolling freely") + _text(96, 24, "braked", _NEW)


def _multipass() -> str:
    outline = "M0 100H70A26 26 0 0 0 92 88H160A26 26 0 0 0 182 72H240"
    return (_soil(outline) + _wheel(70, 74, 26) + _wheel(160, 62, 26)
            + _text(160, 26, "N = 1", _NEW, "middle") + _text(70, 38, "N = 2", _NEW, "middle")
            + _arrow(12, 88, 0, 12))  # fmt: skip


def _bulldozing() -> str:
    heap = '<path d="M151 72C156 50 176 50 196 72Z" fill="#0072b2" fill-opacity=".25" '
    return (_rolling() + heap + 'stroke="#0072b2"/>' + _arrow(206, 52, -26, 0)
            + _text(196, 44, "R", _NEW))  # fmt: skip


def _elastic_rebound() -> str:
    outline = f"M0 80H60C84 80 92 90 110 {_RUT}H120A34 34 0 0 0 149 {_GROUND}H{_WIDTH}"
    return (_soil(outline) + _wheel(120, 56) + _path("M0 90H110", _NEW, "4 3")
            + _arrow(34, 100, 0, -19) + _text(42, 108, "comes up again", _NEW))  # fmt: skip


def _hardpan() -> str:
    hatch = "".join(_path(f"M{x} 122l10 -12", _NEW) for x in range(4, 236, 14))
    return _rolling() + _path("M0 108H240", _NEW, width=2.4) + hatch + _text(160, 104, "hard layer",
                                                                              _NEW)  # fmt: skip


def _penetration_rate() -> str:
    outline = "M0 98H60A26 26 0 0 0 80 72H110V80H176A26 26 0 0 0 196 72H240"
    return (_soil(outline) + _wheel(60, 72, 26) + _wheel(176, 54, 26) + _arrow(60, 34, 14, 0)
            + _arrow(176, 16, 40, 0) + _text(30, 38, "slow", _NEW)
            + _text(142, 20, "fast", _NEW))  # fmt: skip


def _slip_angle() -> str:
    tyre = '<rect x="92" y="44" width="66" height="24" rx="3" transform="rotate(-28 125 56)"/>'
    return (tyre + _arrow(125, 56, 78, 0) + _path("M125 56L196 18", _INK, "4 3")
            + _path("M165 56A40 40 0 0 0 160 37", _NEW) + _text(170, 48, "β", _NEW)
            + _text(206, 60, "travel", _INK) + _text(12, 116, "seen from above"))  # fmt: skip


def _slip_resistance() -> str:
    return _rolling() + _spin() + _arrow(206, 56, -34, 0) + _text(196, 48, "R", _NEW)


def _slope() -> str:
    ground = _soil("M0 116L240 56")
    return (ground + _wheel(112, 52) + _arrow(112, 52, 0, 40, _INK)
            + _arrow(112, 52, -32, 8) + _text(118, 96, "W") + _text(26, 56, "W sin α", _NEW))  # fmt: skip


def _grouser() -> str:
    lugs = "".join(
        _path(f"M{120 + 34 * cos(a):.1f} {56 + 34 * sin(a):.1f}L{120 + 42 * cos(a):.1f} "
              f"{56 + 42 * sin(a):.1f}", _NEW, width=3)
        for a in (k * pi / 6 for k in range(12))
    )  # fmt: skip
    return _rolling() + lugs + _text(168, 100, "h", _NEW)


def _contact_geometry() -> str:
    arc = _path("M120 90A34 34 0 0 0 150 72", _NEW, width=3.4)
    rays = _path("M120 56V90M120 56L150 72", _INK, "3 3", 1)
    return _rolling() + arc + rays + _text(126, 78, "θ", _NEW)


def _rig_friction() -> str:
    rail = _path("M0 12H240M0 20H240") + _path("M104 12h32v8h-32zM120 20V56")
    return _rolling() + rail + _arrow(84, 34, -30, 0) + _text(20, 52, "F of the rig", _NEW)


def _modulus_over(setting: str) -> Callable[[], str]:
    return lambda: _graph(setting, "k", "M40 92C90 60 150 40 216 34")


EFFECTS: dict[str, Callable[[], str]] = {
    "slip_sinkage": _slip_sinkage,
    "skid_sinkage": _skid_sinkage,
    "multipass": _multipass,
    "bulldozing": _bulldozing,
    "elastic_rebound": _elastic_rebound,
    "hardpan": _hardpan,
    "penetration_rate": _penetration_rate,
    "slip_angle_sinkage": _slip_angle,
    "slip_resistance": _slip_resistance,
    "slope": _slope,
    "grouser": _grouser,
    "contact_geometry": _contact_geometry,
    "rig_friction": _rig_friction,
    "load_dependent_modulus": _modulus_over("load"),
    "width_dependent_modulus": _modulus_over("width"),
    "moisture": _modulus_over("water content"),
    "load_gain": _instrument("load", True),
    "load_offset": _instrument("load", False),
    "sinkage_gain": _instrument("sinkage", True),
    "sinkage_offset": _instrument("sinkage", False),
    "resistance_gain": _instrument("resistance", True),
    "resistance_offset": _instrument("resistance", False),
}
