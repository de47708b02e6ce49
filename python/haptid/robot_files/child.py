"""The child process of `limited.py`: foreign parsers under limits; a script that imports nothing of haptid.

It limits itself before it imports anything else, reads a request as JSON, opens no file outside the allowed folders,
and writes its answer as JSON.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Sequence
from typing import Any

# Processor time, s, and memory, bytes.
CPU_SECONDS, MEMORY_LIMIT = 40, 6 * 2**30
# Arrays of the compiled model that a tree is made of.
_ARRAYS = (
    "body_parentid",
    "body_pos",
    "body_quat",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_jntadr",
    "body_jntnum",
    "body_gravcomp",
    "body_mocapid",
    "jnt_type",
    "jnt_axis",
    "jnt_pos",
    "jnt_qposadr",
    "jnt_dofadr",
    "jnt_bodyid",
    "jnt_limited",
    "jnt_range",
    "jnt_stiffness",
    "jnt_stiffnesspoly",
    "jnt_actfrclimited",
    "jnt_actfrcrange",
    "dof_damping",
    "dof_dampingpoly",
    "dof_armature",
    "dof_frictionloss",
    "qpos0",
    "qpos_spring",
    "eq_type",
    "eq_obj1id",
    "eq_obj2id",
    "eq_objtype",
    "eq_active0",
    "eq_data",
    "tendon_adr",
    "tendon_num",
    "tendon_stiffness",
    "tendon_damping",
    "tendon_armature",
    "tendon_frictionloss",
    "tendon_length0",
    "tendon_lengthspring",
    "tendon_stiffnesspoly",
    "tendon_dampingpoly",
    "wrap_type",
    "wrap_objid",
    "wrap_prm",
    "actuator_trntype",
    "actuator_trnid",
    "actuator_gear",
    "actuator_gaintype",
    "actuator_gainprm",
    "actuator_biastype",
    "actuator_armature",
    "actuator_damping",
    "actuator_forcelimited",
    "actuator_forcerange",
    "site_bodyid",
    "site_pos",
    "site_quat",
    "geom_type",
    "geom_bodyid",
    "geom_pos",
    "geom_quat",
    "geom_size",
    "geom_contype",
    "geom_conaffinity",
)
_NAMED = ("body", "joint", "equality", "tendon", "actuator", "site")


def _limit() -> None:
    try:
        import resource
    except ImportError:  # no such limits on Windows: the time limit of the parent holds
        return
    for what, most in ((resource.RLIMIT_CPU, CPU_SECONDS), (resource.RLIMIT_CORE, 0), (resource.RLIMIT_FSIZE, 2**24)):
        resource.setrlimit(what, (most, most))
    if sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))


class OutsideError(Exception):
    """The child was asked to open what it may not."""


class MissingInputError(Exception):
    """A package or an argument that the file requires was not stated."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.advice = advice


def _guard(folders: Sequence[str]) -> None:
    """Refuse to open files outside these folders and Python's own, and to start processes or connections."""
    packages = [path for path in sys.path if os.path.basename(path) in ("site-packages", "dist-packages")]
    own = [*packages, sys.prefix, sys.base_prefix, os.path.dirname(os.__file__)]
    roots = [os.path.realpath(folder) for folder in (*folders, *own) if folder]

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event.startswith(("subprocess.", "socket.", "os.system", "os.exec", "os.posix_spawn", "os.fork", "ctypes.")):
            raise OutsideError(f"it tries to call {event}")
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | bytes):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if path != os.devnull and not any(path == root or path.startswith(root + os.sep) for root in roots):
                raise OutsideError(f"it reads {os.fsdecode(arguments[0])}, outside its folder and the packages stated")

    sys.addaudithook(audit)


def prepare_xacro() -> None:
    """Import what opens Python's own files, before the child is guarded."""
    import encodings.idna  # noqa: F401
    import xml.dom.minidom  # noqa: F401

    import xacro  # noqa: F401
    import yaml  # noqa: F401


def run_xacro(request: dict[str, Any]) -> dict[str, Any]:
    """Expand a file, in the child."""
    import xacro
    from xacro import substitution_args

    packages, unknown = request["packages"], []

    def find(name: str, *_: object) -> str:
        if name not in packages:
            unknown.append(name)
            raise ValueError(f"package {name!r} is not known")
        return str(packages[name])

    def no_environment(name: str, *_: object) -> str:
        raise ValueError(f"$(env {name}) and $(optenv {name}) are not read")

    substitution_args._eval_find = find
    substitution_args._eval_env = substitution_args._eval_optenv = no_environment
    os.environ.clear()
    try:
        document = xacro.process_file(request["path"], mappings=request["arguments"])
    except Exception as error:
        if unknown:
            advice = f"State the folder that holds it: --package {unknown[0]}=FOLDER."
            raise MissingInputError(f"it reads files of package {unknown[0]!r}, which is not known", advice) from error
        missing = re.search(r"Undefined substitution argument (\S+)", str(error))
        if missing is None:
            raise
        raise MissingInputError(*_missing_argument(request["path"], missing[1])) from error
    return {"text": document.toprettyxml(indent=" ")}


def _missing_argument(path: str, name: str) -> tuple[str, str]:
    """What is wrong with a xacro file whose argument has no value, and what to do, with its other arguments."""
    from xml.dom import minidom

    nodes = [node for node in minidom.parse(path).getElementsByTagName("*") if node.localName == "arg"]
    # Defaults that are made of others are of no use to a reader.
    known = {a.getAttribute("name"): value for a in nodes if "$" not in (value := a.getAttribute("default") or "$")}
    advice = f"State one: --xacro-arg {name}={known.pop(name, 'VALUE')}."
    others = ", ".join(f"{key} ({value})" for key, value in list(known.items())[:12])
    return f"its argument {name!r} is used without a value", advice + (
        f" Others, with defaults: {others}." if others else ""
    )


def prepare_mjcf() -> None:
    """Import MuJoCo, before the child is guarded."""
    import mujoco
    import numpy

    mujoco.MjSpec.from_string("<mujoco/>").compile()
    numpy.zeros(1)


def run_mjcf(request: dict[str, Any]) -> dict[str, Any]:
    """The compiled model of a file: arrays, names, and bodies whose inertia is computed from shapes."""
    import mujoco

    spec = mujoco.MjSpec.from_file(request["path"])
    guessed, meshes = _without_pictures(mujoco, spec, request["folders"])
    model = spec.compile()
    flags = mujoco.mjtDisableBit
    disabled = {
        key: bool(model.opt.disableflags & int(flag))
        for key, flag in (
            ("gravity", flags.mjDSBL_GRAVITY),
            ("spring", flags.mjDSBL_SPRING),
            ("damper", flags.mjDSBL_DAMPER),
            ("equality", flags.mjDSBL_EQUALITY),
            ("frictionloss", flags.mjDSBL_FRICTIONLOSS),
        )
    }
    enums = {
        "joint": {k.value: k.name.removeprefix("mjJNT_").lower() for k in _members(mujoco.mjtJoint)},
        "equality": {k.value: k.name.removeprefix("mjEQ_").lower() for k in _members(mujoco.mjtEq)},
        "wrap": {k.value: k.name.removeprefix("mjWRAP_").lower() for k in _members(mujoco.mjtWrap)},
        "transmission": {k.value: k.name.removeprefix("mjTRN_").lower() for k in _members(mujoco.mjtTrn)},
        "geom": {k.value: k.name.removeprefix("mjGEOM_").lower() for k in _members(mujoco.mjtGeom)},
    }
    counts = {"body": model.nbody, "joint": model.njnt, "equality": model.neq, "tendon": model.ntendon}
    counts |= {"actuator": model.nu, "site": model.nsite}
    objects = {kind: getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}") for kind in _NAMED}
    return {
        "name": spec.modelname,
        "gravity": model.opt.gravity.tolist(),
        "fluid": bool(model.opt.density or model.opt.viscosity),
        "disabled": disabled,
        "enums": {kind: {str(k): name for k, name in values.items()} for kind, values in enums.items()},
        "names": {
            kind: [mujoco.mj_id2name(model, int(objects[kind]), k) or "" for k in range(counts[kind])]
            for kind in _NAMED
        },
        "guessed": [body.id for body in spec.bodies if body.name in guessed or id(body) in guessed],
        "meshes": [geom.id for geom in meshes],
        "site_type": int(mujoco.mjtObj.mjOBJ_SITE),
        "plain_gain": [int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_NONE)],
        "flexes": model.nflex,
        "plugins": model.nplugin,
        "arrays": {name: getattr(model, name).tolist() for name in _ARRAYS if hasattr(model, name)},
    }


def _members(enum: Any) -> list[Any]:
    return [getattr(enum, name) for name in dir(enum) if name.startswith("mj") and not name.startswith("mjN")]


def _without_pictures(mujoco: Any, spec: Any, folders: list[str]) -> tuple[set[Any], list[Any]]:
    """Remove all files that no inertia depends on.

    Names (or ids) of bodies whose inertia is computed from shapes, and geoms whose shape was in such a file.
    """
    always = int(spec.compiler.inertiafromgeom) == int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
    never = int(spec.compiler.inertiafromgeom) == int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE)
    low, high = (int(x) for x in spec.compiler.inertiagrouprange)
    guessed: set[Any] = set()
    meshes: list[Any] = []
    needed: set[str] = set()
    shape = mujoco.mjtGeom
    for body in spec.bodies:
        counted = not never and (always or not body.explicitinertial) and body.name != "world"
        if counted:
            guessed |= {body.name} if body.name else {id(body)}
        for geom in body.geoms:
            geom.material = ""
            if int(geom.type) in (int(shape.mjGEOM_HFIELD), int(shape.mjGEOM_SDF)):
                geom.type, geom.hfieldname, geom.size = shape.mjGEOM_PLANE, "", [1, 1, 1]
                meshes.append(geom)
            weightless = geom.mass == 0 or geom.density == 0 or not low <= geom.group <= high
            if geom.meshname and counted and not weightless:
                needed.add(geom.meshname)
            elif geom.meshname:
                meshes.append(geom)
                geom.meshname, geom.type, geom.size = "", shape.mjGEOM_SPHERE, [0.01, 0, 0]
                if counted:
                    geom.mass = 0
    for site in spec.sites:
        site.material = ""
    for tendon in spec.tendons:
        tendon.material = ""
    folder = os.path.join(spec.modelfiledir or "", spec.meshdir or "")
    for mesh in list(spec.meshes):
        if mesh.name not in needed and os.path.splitext(os.path.basename(mesh.file or ""))[0] not in needed:
            spec.delete(mesh)
        elif mesh.file:
            _expect_inside(os.path.join(folder, mesh.file), folders)
    for kind in ("skins", "materials", "textures", "hfields"):
        for entry in list(getattr(spec, kind)):
            spec.delete(entry)
    return guessed, meshes


def _expect_inside(path: str, folders: list[str]) -> None:
    real = os.path.realpath(path)
    if not any(real.startswith(os.path.realpath(folder) + os.sep) for folder in folders):
        raise OutsideError(f"it needs the mesh {path}, outside its folder and the packages stated")


# Most prims of a stage that are looked at, and most layers that it is composed of.
_MOST_PRIMS, _MOST_LAYERS = 200_000, 500


def prepare_usd() -> None:
    """Import USD, whose plugins are Python's own files, before the child is guarded."""
    import numpy  # noqa: F401
    from pxr import Usd, UsdGeom, UsdPhysics

    UsdGeom.XformCache()
    stage = Usd.Stage.CreateInMemory()  # kept: its prims live as long as it does
    stage.DefinePrim("/body", "Xform").HasAPI(UsdPhysics.RigidBodyAPI)


def run_usd(request: dict[str, Any]) -> dict[str, Any]:
    """Bodies, joints, scenes and collision shapes of a stage: their attributes, relations and poses in the stage."""
    from pxr import Tf, Usd, UsdGeom, UsdPhysics

    try:
        _expect_layers_inside(request["path"], request["folders"])
        stage = Usd.Stage.Open(request["path"])
    except Tf.ErrorException as error:  # its text names USD's own source files first
        said = "; ".join(str(one.commentary) for one in error.args)
        raise ValueError(re.sub(r"pxrInternal\S*", "its syntax", said)) from None
    poses, made = UsdGeom.XformCache(), {}
    for k, prim in enumerate(stage.Traverse(Usd.TraverseInstanceProxies())):
        if k >= _MOST_PRIMS:
            raise ValueError(f"it has more than {_MOST_PRIMS} prims")
        body = prim.HasAPI(UsdPhysics.RigidBodyAPI)
        joint, scene = prim.IsA(UsdPhysics.Joint), prim.IsA(UsdPhysics.Scene)
        if body or joint or scene or prim.HasAPI(UsdPhysics.CollisionAPI):
            role = "body" if body else "joint" if joint else "scene" if scene else "shape"
            made[str(prim.GetPath())] = {"role": role} | _prim(prim)
    targets = [path for prim in made.values() for paths in prim["relations"].values() for path in paths]
    frames = {}
    for path in {*targets, *made}:
        prim = stage.GetPrimAtPath(path)
        if prim:
            # Row vectors in USD: transposed, a pose as everywhere here.
            matrix = poses.GetLocalToWorldTransform(prim)
            frames[path] = [[matrix[column][row] for column in range(4)] for row in range(4)]
    return {
        "metres": UsdGeom.GetStageMetersPerUnit(stage),
        "kilograms": UsdPhysics.GetStageKilogramsPerUnit(stage),
        "up": str(UsdGeom.GetStageUpAxis(stage)),
        "name": stage.GetDefaultPrim().GetName() if stage.GetDefaultPrim() else "",
        "prims": made,
        "frames": frames,
    }


def _expect_layers_inside(path: str, folders: list[str]) -> None:
    """Refuse a stage that is composed of files outside the folders: USD's own code opens them, unseen by the guard."""
    from pxr import Sdf

    waiting, seen = [path], set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        if len(seen) > _MOST_LAYERS:
            raise ValueError(f"it is composed of more than {_MOST_LAYERS} layers")
        file = name.split("[")[0]  # a layer within a package: a.usdz[b.usd]
        if not os.path.isabs(file):  # found nowhere
            raise ValueError(f"the layer {file} cannot be read")
        real = os.path.realpath(file)
        if not any(real.startswith(os.path.realpath(folder) + os.sep) for folder in folders):
            raise OutsideError(f"it refers to {file}, outside its folder and the packages stated")
        layer = Sdf.Layer.FindOrOpen(name) if os.path.isfile(real) else None
        if layer is None:
            raise ValueError(f"the layer {file} cannot be read")
        # An empty name is the layer itself.
        waiting += [layer.ComputeAbsolutePath(found) for found in layer.GetCompositionAssetDependencies() if found]


def _prim(prim: Any) -> dict[str, Any]:
    values = {found.GetName(): _value(found) for found in prim.GetAttributes()}
    return {
        "type": str(prim.GetTypeName()),
        "schemas": [str(name) for name in prim.GetAppliedSchemas()],
        "values": {name: value for name, value in values.items() if value is not None},
        "relations": {
            found.GetName(): [str(x) for x in found.GetForwardedTargets()] for found in prim.GetRelationships()
        },
    }


def _value(attribute: Any) -> Any:
    """A number, word, vector or quaternion w x y z at the default time; None for anything else.

    Of single precision the shortest decimal number that is stored so: 0.1 and not 0.10000000149.
    """
    import numpy
    from pxr import Gf

    kind = str(attribute.GetTypeName())
    if kind.endswith("[]") or kind == "asset" or kind.startswith("matrix"):
        return None
    value = attribute.Get()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Gf.Quatf | Gf.Quatd | Gf.Quath):
        value = [value.GetReal(), *value.GetImaginary()]
    try:
        numbers = [float(x) for x in value] if hasattr(value, "__len__") else float(value)
    except (TypeError, ValueError):
        return None
    if "double" in kind or kind == "quatd":
        return numbers
    if isinstance(numbers, list):
        return [float(str(numpy.float32(x))) for x in numbers]
    return float(str(numpy.float32(numbers)))


_TASKS = {"xacro": (prepare_xacro, run_xacro), "mjcf": (prepare_mjcf, run_mjcf), "usd": (prepare_usd, run_usd)}


def main() -> None:
    """Run the task that is asked for on standard input, and write the answer on standard output."""
    _limit()
    asked = json.load(sys.stdin)
    out, sys.stdout = sys.stdout, sys.stderr  # libraries print
    try:
        prepare, run = _TASKS[asked["task"]]
        prepare()
        _guard(asked["folders"])
        answer: dict[str, Any] = {"result": run(asked["request"])}
    except ImportError as error:
        answer = {"missing": error.name or str(error)}
    except MemoryError:
        answer = {"error": f"reading it takes more than {MEMORY_LIMIT // 2**30} GiB of memory"}
    except MissingInputError as error:
        answer = {"error": str(error), "advice": error.advice}
    except OutsideError as error:
        advice = "If you trust it, state a folder that holds what it reads: --package NAME=FOLDER."
        answer = {"error": str(error), "advice": advice}
    except RecursionError:
        answer = {"error": "it is nested too deeply"}
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        answer = {"error": f"its parser says: {text[:400].rstrip('.')}"}
    json.dump(answer, out)
    out.flush()


if __name__ == "__main__":
    main()
