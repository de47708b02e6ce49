"""Models within a model of SDF, written in it or included, as links, joints and frames of one model.

Names of a nested model's links, joints and frames are `MODEL::NAME`, and its own frame is `MODEL`.

Source: http://sdformat.org, "Composition" and "Pose frame semantics" of specification 1.11.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from haptid._internal.late import dataclass
from haptid._internal.numerals import whole_number
from haptid.robot_files.paths import Roots
from haptid.robot_files.xml import Element, parse, read_bytes

OWN_FRAME, WORLD = "__model__", "world"
# Attribute of the link that a model's frame is fixed to, here also of the frame that stands for a nested model.
CANONICAL = "canonical_link"
# Models within models that are followed, and how deeply.
_MOST, _DEEPEST = 500, 10
_PLACED = ("link", "frame")


@dataclass
class Models:
    """Follows the models within the models of a file.

    Attributes:
        roots: folders that included files may be in.
        count: nested models so far.
    """

    roots: Roots
    count: int = 0

    def flat(self, model: Element, depth: int = 0) -> Element:
        """A model without models in it.

        Raises:
            RobotFileError: an included file is not found, is in no stated package or has no model; models are nested
                too deeply, or are too many; a nested model is placed by another frame than its own.
        """
        children: list[Element] = []
        for child in model.children:
            if child.tag not in ("model", "include"):
                children.append(child)
                continue
            self.count += 1
            if depth >= _DEEPEST or self.count > _MOST:
                child.refuse(f"is model {self.count} in {depth} others", f"Keep {_DEEPEST} levels and {_MOST} models.")
            children += _within(child, self.flat(self.resolved(child), depth + 1))
        return replace(model, children=children)

    def resolved(self, place: Element) -> Element:
        """The model that stands, or is included, at a place."""
        if place.tag == "model":
            return place
        uri = place.only("uri")
        path = self.roots.resolved(uri.text.strip(), self.roots.folder, uri.line)
        if path.is_dir():
            path = self.roots.resolved(self._file_of(path.name, uri, path / "model.config"), path, uri.line)
        if not path.is_file():
            uri.refuse(
                f"names {uri.text.strip()!r}, which has no file {path.name}", "Correct it, or state its package."
            )
        root = parse(read_bytes(path), str(path))
        if root.tag != "sdf" or root.first("model") is None:
            root.refuse("holds no <model>", "Give an SDF of a model where it is included.")
        return root.only("model")

    def _file_of(self, name: str, uri: Element, config: Path) -> str:
        """The newest SDF that the `model.config` of a folder names."""
        if not config.is_file():
            return "model.sdf"
        files = [element for element in parse(read_bytes(config), str(config)).all("sdf") if element.text.strip()]
        if not files:
            uri.refuse(f"names the folder {name!r}, whose model.config has no <sdf>", "Correct that file.")
        return max(files, key=_version).text.strip()


def _version(element: Element) -> list[int]:
    return [whole_number(part) or 0 for part in element.attributes.get("version", "0").split(".")]


def _within(place: Element, model: Element) -> Iterator[Element]:
    """The frame of a nested model, and its elements, by their names in the model around it."""
    placed = place.first("placement_frame")
    if placed is not None or model.attributes.get("placement_frame"):
        place.refuse("is placed by another frame than its own", "Give <pose> of the model's own frame.")
    merged = place.attributes.get("merge", "").strip() in ("true", "1")
    named = place.first("name")
    own = named.text.strip() if named is not None else model.name()
    frame = f"{own}::{OWN_FRAME}" if merged else own

    def outer(name: str) -> str:
        name = name.strip()
        if name in ("", WORLD):
            return name
        return frame if name == OWN_FRAME else name if merged else f"{own}::{name}"

    pose = place.first("pose") or model.first("pose")
    attributes = {"name": frame, CANONICAL: outer(canonical_link(model))}
    yield replace(place, tag="frame", attributes=attributes, children=[] if pose is None else [pose])
    for child in model.children:
        if child.tag in ("link", "joint", "frame"):
            yield _renamed(child, outer, frame)


def canonical_link(model: Element) -> str:
    """The link that a model's own frame is fixed to; empty where the model has none."""
    links = [element.name() for element in model.all("link")]
    return model.attributes.get(CANONICAL, "").strip() or (links[0] if links else "")


def _renamed(element: Element, outer: Callable[[str], str], frame: str, inside: bool = False) -> Element:
    """An element of a nested model with the names of the model around it; poses are relative to the model's frame.

    Elements inside it have no names of the model's: `<frame>` of a force sensor says in which frame it measures.
    """
    attributes = dict(element.attributes)
    for key in ("relative_to", "attached_to", "expressed_in", "joint"):
        if key in attributes:
            attributes[key] = outer(attributes[key])
    text = outer(element.text) if element.tag in ("parent", "child") else element.text
    children = [_renamed(child, outer, frame, True) for child in element.children]
    if not inside:
        attributes["name"] = outer(element.name())
    if element.tag in _PLACED and not inside and not attributes.get("attached_to"):
        old = next((child for child in children if child.tag == "pose"), None)
        pose = replace(element, tag="pose", text="", attributes={}, children=[]) if old is None else old
        placed = replace(pose, attributes={"relative_to": frame, **{k: v for k, v in pose.attributes.items() if v}})
        children = [placed, *(child for child in children if child is not old)]
    if element.tag == "axis":
        flag = next((child for child in children if child.tag == "use_parent_model_frame"), None)
        if flag is not None and flag.text.strip() in ("1", "true"):
            children = [
                replace(child, attributes={**child.attributes, "expressed_in": frame}) if child.tag == "xyz" else child
                for child in children
                if child is not flag
            ]
    return replace(element, attributes=attributes, text=text, children=children)
