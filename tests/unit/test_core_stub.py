"""The stub of the compiled module matches the binary."""

import ast
from pathlib import Path

import haptid
from haptid import _core


def test_stub_and_binary_have_the_same_names():
    tree = ast.parse((Path(haptid.__file__).parent / "_core.pyi").read_text())
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    public = {name for name in dir(_core) if not name.startswith("_")}
    assert functions | set(classes) == public
    for name, node in classes.items():
        stub = {item.name for item in node.body if isinstance(item, ast.FunctionDef)} - {"__new__"}
        assert stub == {item for item in dir(getattr(_core, name)) if not item.startswith("_")}


def test_signatures_name_the_same_arguments():
    tree = ast.parse((Path(haptid.__file__).parent / "_core.pyi").read_text())
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    for node in classes:
        for item in node.body:
            if isinstance(item, ast.FunctionDef) and not item.decorator_list and item.name != "__new__":
                text = getattr(getattr(_core, node.name), item.name).__text_signature__
                wanted = [arg.arg for arg in item.args.args if arg.arg != "self"]
                assert [part.strip().split("=")[0] for part in text.strip("()").split(",")][1:] == wanted
