"""What decides sample counts, and what it is told; public as `sssfit.estimators.policies`."""

from typing import Any, NamedTuple, Protocol

from jax import Array


class Known(NamedTuple):
    """What is known of a frame before it is sampled, arrays of the pixels' shape.

    Attributes:
        control: the light on the pixel itself.
        surround: the mean light around it, as a coarser level of the lighting has it.
        sample_variance: of one sample; the exact one, for an oracle alone.
        missing: whether the pixels have no history.
    """

    control: Array
    surround: Array
    sample_variance: Array
    missing: Array


class Sampled(NamedTuple):
    """What a frame's samples brought, arrays of the pixels' shape.

    Attributes:
        count: how many there were.
        mean: their mean, the frame's result.
        square_deviation: sum of their squared deviations from it.
    """

    count: Array
    mean: Array
    square_deviation: Array


class Learned(NamedTuple):
    """What a policy remembers after a frame, for the record.

    Attributes:
        mean: its moving mean.
        variance: the variance of a frame's result that it believes in.
        coefficient: of the control.
    """

    mean: Array
    variance: Array
    coefficient: Array


class Policy(Protocol):
    """How many samples, and what is learned from them."""

    def init(self, like: Array) -> Any:
        """The memory before the first frame."""
        ...

    def count(self, state: Any, known: Known) -> Array:
        """How many samples each pixel draws, int32."""
        ...

    def learn(self, state: Any, known: Known, sampled: Sampled) -> tuple[Any, Learned]:
        """The memory after a frame, each pixel's from its own numbers alone: it may be given a few rows."""
        ...
