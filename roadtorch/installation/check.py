"""What is found out about one part of an installation."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

State = Literal["ok", "missing", "broken"]


@dataclass(frozen=True)
class Check:
    """One line of the report.

    state: missing is what can do without, broken is what cannot. what: version, figures, or what
    is wrong. remedy: what to do, where something is to be done. figures: numbers of ``what``, for
    programs.
    """

    name: str
    state: State
    what: str
    remedy: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
