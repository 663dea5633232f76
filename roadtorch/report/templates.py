"""Pages from templates that lie in this package; whatever is put in is text and only text."""

import base64
import hashlib
from importlib.resources import files

import jinja2


def template(path: str) -> jinja2.Template:
    """A template by its path in this package, "page/report.html"."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_text_of),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sha256"] = _sha256
    return environment.get_template(path)


def _text_of(path: str) -> str:
    return files("roadtorch.report").joinpath(path).read_text(encoding="utf-8")


def _sha256(script: str) -> str:
    """The name by which a content security policy allows one script and no other."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
