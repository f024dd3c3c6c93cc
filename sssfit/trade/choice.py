"""What is compared: choices that do the same thing, at different costs and with different errors.

A group is declared in a file of its own, which `registry` lists: what it is about, what its error is and what
that is measured against. Its choices are made for a setting, when they are to be measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

Cost = Literal["time", "samples"]


class Error(NamedTuple):
    """An error and how uncertain it is itself.

    Attributes:
        value: >= 0, in the group's unit.
        noise: standard error of that; 0 where nothing is random.
    """

    value: float
    noise: float = 0.0


@dataclass(frozen=True)
class Choice:
    """One way to do what its group does.

    Attributes:
        name: unique in its group.
        knobs: what is set for it, by name: strings, numbers, booleans or None.
        run: does it once; returns when the result is there.
        error: measures the result's error; called once.
        samples: drawn for each unit of work, or what tells it once the choice has run; 0 where none are.
        bytes_moved: read and written at least for each unit of work, by an algorithm that keeps nothing.
        is_default: what the package does where nothing is said.
    """

    name: str
    knobs: Mapping[str, Any]
    run: Callable[[], Any]
    error: Callable[[], Error]
    samples: float | Callable[[], float] = 0.0
    bytes_moved: float = 0.0
    is_default: bool = False


@dataclass(frozen=True)
class Task:
    """What a group's choices have to do in a setting.

    Attributes:
        units: of work in a run, such as pixels.
        choices: those that are compared, at least one.
        note: a sentence on the work, such as its size.
    """

    units: int
    choices: tuple[Choice, ...]
    note: str = ""


class CannotMeasure(Exception):
    """A setting lacks what a group needs; the message says what."""


@dataclass(frozen=True)
class Group:
    """Choices that can stand for each other.

    Attributes:
        name: as `sssfit trade --only` takes it.
        title: what is chosen.
        unit: of work, singular, such as "pixel".
        error: what the error is, with its unit.
        reference: what it is measured against.
        prepare: makes the task in a setting; raises `CannotMeasure`.
        cost: what is paid: "time", or "samples" where drawing one is meant to cost more than all else.
        stands_for: the public functions that its choices call, as "sampling.inverse_cdf.xie".
        beside_the_front: why a default that another choice beats is the default all the same; empty if none
            should.
    """

    name: str
    title: str
    unit: str
    error: str
    reference: str
    prepare: Callable[..., Task]
    cost: Cost = "time"
    stands_for: tuple[str, ...] = ()
    beside_the_front: str = ""
