"""Tables as pixels: which axis runs along which side of an image."""

from typing import Any

import numpy as np

from sssfit.tables.formats.metadata import refusal, stored_shape


def to_image(values: np.ndarray) -> np.ndarray:
    """Arrange a table's values as the pixels of an image.

    Args:
        values: shape (width, channels) of a 1-D table or (height, width, channels) of a 2-D one.

    Returns:
        Shape (height, width, channels); a 1-D table has one row.

    Example:
        >>> to_image(np.zeros((5, 3))).shape
        (1, 5, 3)
    """
    return values[np.newaxis] if values.ndim == 2 else values


def from_image(channels: list[np.ndarray], metadata: dict[str, Any], path: object) -> np.ndarray:
    """Collect a table's values from the pixels of an image: the inverse of `to_image`.

    Args:
        channels: pixels of each channel, shape (height, width), in the table's order.
        metadata: the metadata, which tell the expected size.
        path: the file, for messages.

    Returns:
        The values in the shape of the table.

    Raises:
        FileError: the image has another size.

    Example:
        >>> metadata = {"axes": [{"size": 5}], "channels": ["R", "G"]}
        >>> from_image([np.zeros((1, 5)), np.ones((1, 5))], metadata, "t.exr").shape
        (5, 2)
    """
    shape = stored_shape(metadata)
    height, width = (1, *shape[:-1])[-2:]
    for pixels in channels:
        if pixels.shape != (height, width):
            found = " x ".join(str(size) for size in reversed(pixels.shape))
            raise refusal(path, f"the image has {found} pixels but the metadata say {width} x {height}")
    return np.stack(channels, axis=-1).reshape(shape)
