"""Documents of other programs and of browsers: bounded models, errors in one line."""

import codecs
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import pydantic
from pydantic import Field

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import DatasetError, RoadtorchError, truncate_middle

# A model bounds every number and list, so that a file cannot make us allocate what it merely
# claims to hold; JSON goes from its bytes straight into the model.

MAX_DOCUMENT_BYTES = 2**28  # ours: a COCO file of a thousand images has as many
MAX_SIDE = 2**20  # pixels, as of an image that is read
MAX_INPUT_LENGTH = 60  # characters of a wrong value that an error repeats

Side = Annotated[int, Field(ge=1, le=MAX_SIDE)]
Coordinate = Annotated[float, Field(ge=-4 * MAX_SIDE, le=4 * MAX_SIDE)]


class ForeignDocument(pydantic.BaseModel):
    """A part of another program's document; keys without a field are ignored."""

    model_config = pydantic.ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


def describe_validation_error(error: pydantic.ValidationError) -> str:
    """Describe the first error of a validation: its position, the requirement, the value."""
    details = error.errors(include_url=False)[0]
    if details["type"] == "json_invalid":
        return f"it is not JSON: {details['msg'].removeprefix('Invalid JSON: ')}"
    position = ".".join(str(part) for part in details["loc"]) or "it"
    if details["type"] == "missing":
        return f"{position} is missing"
    message = details["msg"].removeprefix("Value error, ")
    value = truncate_middle(repr(details["input"]), MAX_INPUT_LENGTH)
    return f"{position}: {message[0].lower()}{message[1:]}, {value} was given"


@contextmanager
def read_document(path: Path, hint: str) -> Iterator[bytes]:
    """Yield the bytes of a file to a block that parses them.

    Errors of files, values and memory in the block become a DatasetError that names the file;
    a RoadtorchError passes unchanged.
    """
    try:
        yield read_regular(path, MAX_DOCUMENT_BYTES).removeprefix(codecs.BOM_UTF8)
    except RoadtorchError:
        raise
    except pydantic.ValidationError as error:
        problem = f"cannot be read: {describe_validation_error(error)}"
        raise DatasetError(path, problem, hint) from None
    except MemoryError:
        raise DatasetError(path, "does not fit in memory", hint) from None
    except (OSError, ValueError, LookupError, ArithmeticError, RecursionError) as error:
        raise DatasetError(path, f"cannot be read: {reason(error)}", hint) from None
