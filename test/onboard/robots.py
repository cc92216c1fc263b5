# SPDX-License-Identifier: Apache-2.0
"""Small robot descriptions of the kinds that people have: how their wheels hang, and no more."""

from __future__ import annotations

CORNERS = {
    "front_left": (1, 1),
    "front_right": (1, -1),
    "rear_left": (-1, 1),
    "rear_right": (-1, -1),
}
SIX = {**CORNERS, "middle_left": (0, 1), "middle_right": (0, -1)}
MESH = "mesh filename='package://robot/wheel.dae'"
_LYING = {"0 1 0": "1.5708 0 0", "1 0 0": "0 1.5708 0"}


def link(name: str, body: str = "", lying: str = "1.5708 0 0") -> str:
    """A link, with a shape whose axis lies across."""
    inside = f"<origin rpy='{lying}'/><geometry><{body}/></geometry>"
    return f"<link name='{name}'>{f'<collision>{inside}</collision>' if body else ''}</link>"


def joint(
    name: str, parent: str, child: str, xyz: str = "0 0 0", axis: str = "0 1 0",
    kind: str = "continuous", body: str = "", limit: str = "",
) -> str:  # fmt: skip
    """A joint and the link below it."""
    lying = _LYING.get(axis.replace("-", ""), "1.5708 0 0")
    limits = f"<limit {limit}/>" if limit else ""
    return (
        f"{link(child, body, lying)}<joint name='{name}' type='{kind}'><parent link='{parent}'/>"
        f"<child link='{child}'/><origin xyz='{xyz}'/><axis xyz='{axis}'/>{limits}</joint>"
    )


def robot(*parts: str, base: str = "base_link") -> str:
    return f"<robot name='robot'>{link(base)}{''.join(parts)}</robot>"


def wheel(name: str, parent: str, xyz: str, radius: float = 0.1, **more: str) -> str:
    more = {"body": f"cylinder radius='{radius}' length='0.08'"} | more
    return joint(name, parent, f"{name}_link", xyz, **more)


HALF_TURN = "lower='-1.5' upper='1.5'"


def four(names: str = "{}_joint", **more: str) -> str:
    """Four wheels on the body."""
    at = {name: f"{0.4 * x} {0.3 * y} 0" for name, (x, y) in CORNERS.items()}
    return robot(*(wheel(names.format(n), "base_link", xyz, **more) for n, xyz in at.items()))


def tracked(*, sprockets: bool = True) -> str:
    """Four rollers on each side, with a sprocket and an idler above and beyond them."""
    parts = [
        wheel(f"roller_{i}_{side}", "base_link", f"{0.2 * i} {y} 0", body=MESH)
        for i in range(4)
        for side, y in (("left", 0.3), ("right", -0.3))
    ]
    ends = [(x, y) for x in (-0.3, 0.9) for y in (0.3, -0.3)] if sprockets else []
    parts += [
        wheel(f"sprocket_{i}", "base_link", f"{x} {y} 0.25", body=MESH)
        for i, (x, y) in enumerate(ends, 1)
    ]
    return robot(*parts)


def rocker_bogie(
    drive: str, steer: str, steered: tuple[str, ...], *extra: str, axis: str = "0 0 1", beside: float = 0.0
) -> str:  # fmt: skip
    """Six wheels on rockers and bogies, of which some are steered, and whatever is on the body.

    drive, steer: names of joints with {along}, {across}, {a}, {l} for a wheel's place in words and letters.
    """
    parts = list(extra)
    for side, y in (("left", 0.4), ("right", -0.4)):
        parts.append(
            joint(f"rocker_{side}", "base_link", f"rocker_{side}", f"0 {y} 0", kind="revolute")
        )
        parts.append(
            joint(
                f"bogie_{side}", f"rocker_{side}", f"bogie_{side}", "-0.3 0 -0.1", kind="revolute"
            )
        )
    for name, (x, y) in SIX.items():
        along, across = name.split("_")
        words = {"along": along, "across": across, "a": along[0].upper(), "l": across[0].upper()}
        above, shift = (
            (f"rocker_{across}", 0.6 * x)
            if along == "front"
            else (f"bogie_{across}", 0.3 + 0.6 * x)
        )
        if name in steered:
            parts.append(
                joint(
                    steer.format(**words),
                    above,
                    f"fork_{name}",
                    f"{shift} 0 0",
                    axis,
                    kind="revolute",
                )
            )
            above, shift = f"fork_{name}", 0.0
        down = -0.3 if along == "front" else -0.2
        parts.append(wheel(drive.format(**words), above, f"{shift} {beside * y} {down}"))
    return robot(*parts)


MAST = joint("mast_pan", "base_link", "mast", "0.3 0 0.8", "0 0 1") + joint(
    "camera_tilt", "mast", "camera", "0 0 0.1", "0 1 0", "revolute", limit="lower='-1' upper='1'"
)
ARM = joint("shoulder", "base_link", "upper_arm", "0.5 0 0.3", "0 1 0") + joint(
    "wrist", "upper_arm", "hand", "0.3 0 0.1", "1 0 0"
)
# As a Mars rover on whose model six of a mast's, arm's and suspension's joints turn about y, too.
CURIOSITY = rocker_bogie("{along}_wheel_{l}_joint", "steer_{a}_{l}_joint",
                         tuple(CORNERS), MAST, ARM)  # fmt: skip
# The steering joints are called wheels, and the wheels differ by the word for their side alone.
OSR = rocker_bogie(
    "{along}_wheel_joint_{across}", "{along}_wheel_joint_{l}", tuple(CORNERS), beside=0.02
)
EXOTER = rocker_bogie("joint_DRV_{l}{a}", "joint_STR_{l}{a}", tuple(CORNERS))
MARTA = rocker_bogie("joint_DRV_{l}{a}", "joint_STR_{l}{a}", tuple(SIX), MAST)


def hunter(axis: str) -> str:
    """Two steered wheels ahead of two that are not; names say fr, which is the front."""
    parts = []
    for side, y in (("left", 0.3), ("right", -0.3)):
        parts.append(
            joint(
                f"fr_steer_{side}_joint",
                "base_link",
                f"fork_{side}",
                f"0.4 {y} 0",
                axis,
                "revolute",
            )
        )
        parts.append(wheel(f"fr_{side}_joint", f"fork_{side}", "0 0 0", body=MESH))
        parts.append(wheel(f"re_{side}_joint", "base_link", f"-0.3 {y} 0", body=MESH))
    return robot(*parts)


def ranger() -> str:
    """Four wheels, all steered, positive to the right."""
    parts = []
    for name, (x, y) in CORNERS.items():
        short = "".join(word[0] for word in name.split("_"))
        at = f"{0.25 * x} {0.19 * y} -0.1"
        parts.append(
            joint(f"{short}_steering_joint", "base_link", f"{short}_fork", at, "0 0 -1", "revolute")
        )
        parts.append(wheel(f"{short}_wheel", f"{short}_fork", "0 0 -0.12"))
    return robot(*parts)


def limo() -> str:
    """Hinges with cylinders of their own steer two wheels, which are outside of them."""
    parts = []
    for name, (x, y) in CORNERS.items():
        above, at = "base_link", f"{0.1 * x} {0.07 * y} -0.1"
        if x > 0:
            side = name.split("_")[1]
            parts.append(
                joint(f"{side}_steering_hinge_wheel", "base_link", f"{side}_hinge", at, "0 0 1", "revolute",
                      "cylinder radius='0.035' length='0.05'")
            )  # fmt: skip
            above, at = f"{side}_hinge", "0 0 0"
        parts.append(
            wheel(f"{name}_wheel", above, at).replace(
                "<origin rpy", f"<origin xyz='0 {0.0225 * y} 0' rpy", 1
            )
        )
    return robot(*parts)


def turned(quarters: int, names: str = "{}_wheel") -> str:
    """Four wheels on a base whose x axis is turned: ahead is so many quarter turns to the left of it."""
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    left = f"{-sine} {cosine} 0"
    parts = []
    for name, (x, y) in CORNERS.items():
        ahead, aside = 0.23 * x, 0.16 * y
        at = f"{cosine * ahead - sine * aside} {sine * ahead + cosine * aside} 0"
        parts.append(wheel(names.format(name), "base_link", at, axis=left))
    return robot(*parts)


def casters() -> str:
    """Two wheels that are driven, and two that follow."""
    parts = [
        wheel(f"{side}_wheel", "base_link", f"0 {y} -0.08")
        for side, y in (("left", 0.17), ("right", -0.17))
    ]
    for side, y in (("l", 0.15), ("r", -0.15)):
        parts.append(
            joint(f"swivel_{side}", "base_link", f"fork_{side}", f"-0.2 {y} -0.05", "0 0 1")
        )
        parts.append(wheel(f"roll_{side}", f"fork_{side}", "-0.04 0 -0.08", 0.05))
    return robot(*parts)


def arm(at: str, side: str = "", joints: int = 6) -> list[str]:
    """An arm whose joints turn about all axes in turn, without end; the last about the long axis."""
    axes = ["0 0 1", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"][-joints:]
    parts, parent = [], "base_link"
    for i, axis in enumerate(axes):
        xyz = at if i == 0 else "0.2 0 0"
        parts.append(joint(f"arm{side}_{i}", parent, f"arm{side}_link_{i}", xyz, axis))
        parent = f"arm{side}_link_{i}"
    return parts


def mobile_manipulator(turns: str = "continuous") -> str:
    """Two wheels, or two that do not turn, below an arm, which has more joints."""
    sides = (("left", 0.2), ("right", -0.2))
    wheels = [
        wheel(f"{side}_wheel_joint", "base_link", f"0 {y} 0.06", kind=turns) for side, y in sides
    ]
    return robot(*wheels, *arm("0.1 0 0.7", joints=7))


def one_caster(wheels: str = "fixed") -> str:
    """Two wheels, and a caster that turns about the axis that a joint has by default."""
    sides = (("left", 0.17), ("right", -0.17))
    parts = [
        wheel(f"{side}_wheel_joint", "base_link", f"0 {y} -0.08", kind=wheels) for side, y in sides
    ]
    parts.append(joint("caster_swivel", "base_link", "fork", "-0.2 0 -0.05", "1 0 0"))
    parts.append(
        wheel("hubcap_joint", "fork", "-0.03 0 -0.06", 0.04).replace(
            "hubcap_joint_link", "caster_wheel"
        )
    )
    return robot(*parts)


def legged(shank: str, knee: str = "knee") -> str:
    """Four legs of a hip and a knee, which both turn without end; what the shank's link has is given."""
    parts = []
    for name, (x, y) in CORNERS.items():
        parts += [
            joint(f"hip_{name}", "base_link", f"thigh_{name}", f"{0.3 * x} {0.2 * y} 0"),
            joint(f"{knee}_{name}", f"thigh_{name}", f"shank_{name}", "0 0 -0.2").replace(
                f"<link name='shank_{name}'></link>", f"<link name='shank_{name}'>{shank}</link>"
            ),
        ]
    return robot(*parts)


def articulated() -> str:
    """A body that bends in its middle."""
    ahead = joint("bend", "base_link", "front_body", "0 0 0", "0 0 1", "revolute")
    parts = [ahead]
    for name, (x, y) in CORNERS.items():
        body, at = ("front_body", 0.5) if x > 0 else ("base_link", -0.5)
        parts.append(wheel(f"{name}_joint", body, f"{at} {0.3 * y} 0"))
    return robot(*parts)
