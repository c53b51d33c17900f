"""`python -m holescout`: the command that is installed beside this interpreter."""

import os
import sys
import sysconfig
from pathlib import Path


def main() -> None:
    """Becomes the command."""
    for scheme in (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")):
        command = Path(sysconfig.get_path("scripts", scheme)) / "holescout"
        if command.exists():
            os.execv(command, [str(command), *sys.argv[1:]])
    raise SystemExit("the command holescout is not beside this interpreter: install the package anew")


if __name__ == "__main__":
    main()
