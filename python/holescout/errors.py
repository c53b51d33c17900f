"""Exceptions. All are `HolescoutError`."""


class HolescoutError(Exception):
    """Something that the command would end with an exit status for.

    `code` is that status: 3 where the input or a setting is wrong, 1 where the machine failed. `expected` and `found` are what the
    message says of the value in question, where it is one value, and otherwise None.
    """

    code = 1

    def __init__(self, message: str, *, found: str | None = None, expected: str | None = None) -> None:
        super().__init__(message)
        self.found = found
        self.expected = expected


class InvalidInput(HolescoutError, ValueError):
    """The input or a setting is wrong: trying again cannot help."""

    code = 3


class RunFailed(HolescoutError, RuntimeError):
    """The machine failed: a full disk, a missing permission, a connection that broke."""

    code = 1
