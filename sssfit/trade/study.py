"""A question that a table and a picture answer, measured as groups of choices are."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Finding:
    """What a study found.

    Attributes:
        sentences: the answer in words, the first one for the command line.
        rows: a table's, all with the same columns: text and numbers.
        facts: whatever else is kept, values that JSON knows.
    """

    sentences: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    facts: Mapping[str, Any]


@dataclass(frozen=True)
class Study:
    """A question.

    Attributes:
        name: as `sssfit trade --only` takes it.
        title: the question.
        about: what was done to answer it, in a few sentences.
        measure: takes a `setting.Setting`, the number of rounds and what is told what is done; raises
            `choice.CannotMeasure` where the setting lacks what is needed.
        picture: draws a finding, a PNG file.
    """

    name: str
    title: str
    about: str
    measure: Callable[..., Finding]
    picture: Callable[[Finding], bytes]
