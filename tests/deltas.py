"""A delta with pairs of rods between ball joints, drawn closed: as MJCF and as a device file."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.geometry import angles, least_turn

BASE, ARM, PLATFORM, APART, DEPTH = 0.1, 0.12, 0.04, 0.03, 0.22
# Mass and moments of arm, rod and platform; the rod's last moment is about its line.
ARM_BODY, ROD_BODY, PLATFORM_BODY = (0.3, (1e-4, 6e-4, 6e-4)), (0.05, (3e-4, 3e-4, 2e-5)), (0.2, (2e-4, 2e-4, 3e-4))


def _arm(k: int) -> tuple[Array, Array, Array, Array]:
    """Hinge, elbow, ball joint on the platform (middle of the pairs), and the hinge's axis."""
    out = np.array([np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    hinge = BASE * out
    elbow = hinge + ARM * (np.cos(0.5) * out + np.sin(0.5) * down)
    return hinge, elbow, PLATFORM * out + DEPTH * down, np.cross(down, out)


def _text(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def delta_mjcf() -> str:
    """Six rods on ball joints, the platform on one of them, the others connected to it."""
    bodies, connects, motors = [], [], []
    centre = np.array([0.0, 0.0, -DEPTH])
    for k in range(3):
        hinge, elbow, ball, axis = _arm(k)
        rods = []
        for side in (-1, 1):
            start, end = elbow + side * APART * axis, ball + side * APART * axis
            line = end - start
            turn = least_turn(line / np.linalg.norm(line))
            x, y = turn[:3, 0], turn[:3, 1]
            inner, length = "", float(np.linalg.norm(line))
            if (k, side) == (0, -1):
                mass, moments = PLATFORM_BODY
                at = turn[:3, :3].T
                inner = f"""<body name="platform" pos="0 0 {length!r}" xyaxes="{_text(at[:, 0])} {_text(at[:, 1])}">
                <joint name="platform ball" type="ball"/>
                <inertial pos="{_text(centre - end)}" mass="{mass}" diaginertia="{_text(np.array(moments))}"/></body>"""
            else:
                connects.append(f'<connect body1="rod{k}{side}" body2="platform" anchor="0 0 {length!r}"/>')
            mass, moments = ROD_BODY
            rods.append(
                f'<body name="rod{k}{side}" pos="{_text(start - hinge)}" xyaxes="{_text(x)} {_text(y)}">'
                f'<joint name="ball{k}{side}" type="ball"/>'
                f'<inertial pos="0 0 {length / 2!r}" mass="{mass}" diaginertia="{_text(np.array(moments))}"/>'
                f"{inner}</body>"
            )
        mass, moments = ARM_BODY
        bodies.append(
            f'<body name="arm{k}" pos="{_text(hinge)}"><joint name="arm{k}" axis="{_text(axis)}"/>'
            f'<inertial pos="{_text((elbow - hinge) / 2)}" mass="{mass}" diaginertia="{_text(np.array(moments))}"/>'
            f"{''.join(rods)}</body>"
        )
        motors.append(f'<motor joint="arm{k}"/>')
    return (
        f'<mujoco><compiler angle="radian"/><worldbody>{"".join(bodies)}</worldbody>'
        f"<equality>{''.join(connects)}</equality><actuator>{''.join(motors)}</actuator></mujoco>"
    )


def delta_device(spin: float = 0.0) -> str:
    """The same as a device file: rods on universal joints whose first axis is turned about the rod by an angle, rad."""
    joints, loops, bodies, symmetries = [], [], [], []
    centre = np.array([0.0, 0.0, -DEPTH])

    def body(link: str, mass: float, com: Array, moments: Array) -> None:
        J = [moments[0, 0], moments[1, 1], moments[2, 2], moments[0, 1], moments[0, 2], moments[1, 2]]
        bodies.append(
            f'[[prior.bodies]]\nlink = "{link}"\nmass = {mass}\ncom = {com.tolist()}\n'
            f"inertia = {[float(x) for x in J]}\n"
        )

    for k in range(3):
        hinge, elbow, ball, axis = _arm(k)
        limits = "limits = { position = [-0.4, 0.4] }"
        joints.append(
            f'[[joints]]\nname = "arm{k}"\nparent = "base"\nxyz = {hinge.tolist()}\naxis = {axis.tolist()}\n{limits}\n'
        )
        body(f"arm{k}", ARM_BODY[0], (elbow - hinge) / 2, np.diag(ARM_BODY[1]))
        for side in (0, 1):
            start, end = (x + (2 * side - 1) * APART * axis for x in (elbow, ball))
            name, line, length = f"rod{k}{side}", end - start, float(np.linalg.norm(end - start))
            c, s = np.cos(spin), np.sin(spin)
            turn = least_turn(line / length)[:3, :3] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            joints.append(
                f'[[joints]]\nname = "{name}"\nparent = "arm{k}"\ntype = "universal"\n'
                f"xyz = {(start - hinge).tolist()}\nrpy = {list(angles(turn))}\n"
            )
            body(name, ROD_BODY[0], np.array([0.0, 0.0, length / 2]), np.diag((*ROD_BODY[1][:2], 0.0)))
            symmetries.append(
                f'[[symmetry]]\nreason = "rods spin freely"\nzero = ["YY{name}", "XY{name}", "XZ{name}", "YZ{name}", '
                f'"MX{name}", "MZ{name}"]\nequal = [["XX{name}", "ZZ{name}"]]\n'
            )
            if (k, side) == (0, 0):
                first, tip = end, turn
                joints.append("PLATFORM")
                continue
            loops.append(
                f'[[loops]]\npassive = ["{name}"{PASSIVE if (k, side) == (0, 1) else ""}]\n'
                f'cut = {{ type = "spherical", body_a = "{name}", frame_a = {{ xyz = [0, 0, {length!r}] }}, '
                f'body_b = "platform", frame_b = {{ xyz = {(end - first).tolist()} }} }}\n'
            )
    length = float(np.linalg.norm(first - _arm(0)[1] + APART * _arm(0)[3]))
    joints[joints.index("PLATFORM")] = (
        f'[[joints]]\nname = "platform"\nparent = "rod00"\ntype = "spherical"\nxyz = [0, 0, {length!r}]\n'
        f"rpy = {list(angles(tip.T))}\n"
    )
    body("platform", PLATFORM_BODY[0], centre - first, np.diag(PLATFORM_BODY[1]))
    head = 'name = "delta"\ngravity = [0, 0, -9.81]\nconvention = "placement"\n'
    return "\n".join([head, *joints, *loops, *symmetries, *bodies])


PASSIVE = ', "rod00", "platform"'
