"""How files are read and written, and the one exception about them."""

from sssfit.files.errors import FileError as FileError
