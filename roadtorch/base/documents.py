"""Documents of other programs and of browsers: bounded models, and one line for any mistake."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import pydantic
from pydantic import Field

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import DatasetError, RoadtorchError, shortened

# A model bounds every number and list, so that nothing is allocated for what a file merely claims;
# JSON goes from its bytes straight into the model.

MAX_DOCUMENT_BYTES = 2**28  # of one file; ours: a COCO file of a thousand images has as many

MAX_SIDE = 2**20  # pixels, as of an image that is read

SHOWN = 60  # letters of a wrong value that a refusal repeats

Side = Annotated[int, Field(ge=1, le=MAX_SIDE)]
Coordinate = Annotated[float, Field(ge=-4 * MAX_SIDE, le=4 * MAX_SIDE)]


class ForeignDocument(pydantic.BaseModel):
    """A part of a document of another program: the keys that are read; others are passed over."""

    model_config = pydantic.ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


def first_mistake(error: pydantic.ValidationError) -> str:
    """Describe the first mistake: where in the document, what should be there, what is there."""
    mistake = error.errors(include_url=False)[0]
    if mistake["type"] == "json_invalid":
        return f"it is not JSON: {mistake['msg'].removeprefix('Invalid JSON: ')}"
    place = ".".join(str(part) for part in mistake["loc"]) or "it"
    if mistake["type"] == "missing":
        return f"{place} is missing"
    message = mistake["msg"].removeprefix("Value error, ")
    value = shortened(repr(mistake["input"]), SHOWN)
    return f"{place}: {message[0].lower()}{message[1:]}, {value} was given"


@contextmanager
def read_document(path: Path, hint: str) -> Iterator[bytes]:
    """Yield the bytes of a file to a block that reads a document from them.

    What goes wrong in the block with files, numbers and memory becomes a DatasetError that names
    the file; errors of ours go through.
    """
    try:
        yield read_regular(path, MAX_DOCUMENT_BYTES)
    except RoadtorchError:
        raise
    except pydantic.ValidationError as error:
        raise DatasetError(path, f"cannot be read: {first_mistake(error)}", hint) from None
    except MemoryError:
        raise DatasetError(path, "is more than there is memory for", hint) from None
    except (OSError, ValueError, LookupError, ArithmeticError, RecursionError) as error:
        raise DatasetError(path, f"cannot be read: {reason(error)}", hint) from None
