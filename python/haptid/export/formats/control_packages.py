"""Packages around the C code: a controller plugin of ros2_control, and a haptic device of CHAI3D.

Source: control.ros.org, "Writing a new controller"; CHAI3D 3.2, cGenericHapticDevice.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Unpack

from haptid.errors import ExportError
from haptid.export.expressions.dialects import DOUBLE
from haptid.export.formats.c_source import Files
from haptid.export.output import CCode, Export, write
from haptid.export.provenance import ExportCriterion, ExportSource, provenance


def export_ros2_control(
    identified: ExportSource, folder: str | Path, code: CCode | None = None, **criterion: Unpack[ExportCriterion]
) -> Export:
    """Write an ament package with a controller plugin of ros2_control: gravity and friction compensation.

    Efforts are limited by the torque limits of the device file; where these are unknown, the parameter file has a line
    to be filled in, and the controller is not configured without it.

    Args:
        identified, criterion: as in `export_c`.
        folder: output folder of the package.
        code: names, and smoothing of friction; the precision is double.

    Raises:
        UnvalidatedModelError, ExportError, ShapeError, OutputFolderError: as in `export_c`.
        ExportError: the device has loops that are not linear.
    """
    files = _files(identified, code, criterion)
    texts = {
        "package.xml": files.filled("ros2/package.xml"),
        "CMakeLists.txt": files.filled("ros2/CMakeLists.txt"),
        "plugin.xml": files.filled("ros2/plugin.xml"),
        "controller.yaml": files.filled("ros2/controller.yaml", **_parameters(files)),
        f"{files.name}_controller.cpp": files.filled("ros2/controller.cpp"),
    }
    return write(folder, texts | _model(files), files.source.verdict)


def export_chai3d(
    identified: ExportSource, folder: str | Path, code: CCode | None = None, **criterion: Unpack[ExportCriterion]
) -> Export:
    """Write a C++ header for CHAI3D: a haptic device around another one, whose forces carry its weight and friction.

    Args:
        identified, criterion: as in `export_c`.
        folder: output folder of NAME_chai3d.h, NAME.h and NAME.c.
        code: names, and smoothing of friction; the precision is double.

    Raises:
        UnvalidatedModelError, ExportError, ShapeError, OutputFolderError: as in `export_c`.
        ExportError: the device has loops that are not linear.
        ExportError: the device has no handle, or one that cannot move in all directions.
    """
    files = _files(identified, code, criterion)
    if "handle_force" not in files.code:
        raise ExportError(
            f"{files.model.device.name} has no handle that moves in all directions, and CHAI3D's forces act there.",
            where=files.model.device.name,
            advice="Add [handle] to the device file, or export to c.",
        )
    texts = {f"{files.name}_chai3d.h": files.filled("chai3d.h")}
    return write(folder, texts | _model(files), files.source.verdict)


def _files(
    identified: ExportSource,
    code: CCode | None,
    criterion: ExportCriterion,
) -> Files:
    files = Files.of(provenance(identified, **criterion), code, DOUBLE)
    device = files.model.device
    if files.code.passive:
        passive = [device.joint_names[j] for j in files.code.passive]
        raise ExportError(
            f"{device.name} has loops that are not linear: the positions of {', '.join(passive)} are "
            "found at every sample, which these packages do not do.",
            where=device.name,
            found=passive,
            advice="Export it as c, and call its loops_update in the controller before all other functions.",
        )
    return files


def _model(files: Files) -> dict[str, str]:
    """Header and source of the model."""
    return {f"{files.name}.h": files.header(), f"{files.name}.c": files.body()}


def _parameters(files: Files) -> dict[str, str]:
    """Names and effort limits for the parameter file; names of joints where the coordinates are joints."""
    device = files.model.device
    moved = [row.nonzero()[0] for row in device.row_map]
    one_each = all(len(row) == 1 for row in moved)
    joints = [device.joints[device.active[row[0]]] for row in moved] if one_each else []
    names = [joint.alias or joint.name for joint in joints] or list(device.row_labels)
    limits = [joint.torque_limit for joint in joints]
    if limits and all(limit is not None for limit in limits):
        line = f"    effort_limits: [{', '.join(repr(float(limit)) for limit in limits if limit is not None)}]"
    else:
        line = "    # effort_limits: []  # the device file has no torque limit for each of them"
    return {
        "labels": ", ".join(device.row_labels),
        "joints": ", ".join(json.dumps(name) for name in names),
        "limits": line,
    }
