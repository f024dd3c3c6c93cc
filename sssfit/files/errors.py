"""The one exception that file trouble raises."""


class FileError(Exception):
    """A file cannot be read or written as asked.

    The message is one sentence for a user: what is wrong, where, and what to do about it.
    The command line prints it and exits with code 2.

    Example:
        >>> raise FileError("materials.csv", "row 3", "unit 'furlong' is not known", "use 1/mm")
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: materials.csv, row 3: unit 'furlong' is not known; use 1/mm
    """

    def __init__(self, file: object, where: str, problem: str, remedy: str):
        """Name the file, the place in it ("" when it is the whole file), the problem, the remedy."""
        place = f"{file}, {where}" if where else f"{file}"
        super().__init__(f"{place}: {problem}; {remedy}")
