"""The texts under the fields of parameter classes, read from their source."""

import ast
import inspect
import textwrap
from dataclasses import fields, is_dataclass
from itertools import pairwise


def parameter_docs(params: object) -> dict[str, str]:
    """Return the text under each single parameter, by dotted name; empty where there is none."""
    if not is_dataclass(params) or isinstance(params, type):
        return {}
    own, docs = dict[str, str](), dict[str, str]()
    for cls in reversed(type(params).__mro__):
        own |= _docs(cls)
    for f in fields(params):
        value = getattr(params, f.name)
        if is_dataclass(value):
            docs |= {f"{f.name}.{path}": text for path, text in parameter_docs(value).items()}
        else:
            docs[f.name] = own.get(f.name, "")
    return docs


def _docs(cls: type) -> dict[str, str]:
    """Texts that follow the fields of one class, as documentation tools read them."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    except (OSError, TypeError, SyntaxError):
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    docs: dict[str, str] = {}
    for field, text in pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
            value = text.value
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                docs[field.target.id] = " ".join(value.value.split())
    return docs
