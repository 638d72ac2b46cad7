"""The command line, as `python -m pepperscene`."""

from __future__ import annotations

from pepperscene.cli import main

if __name__ == "__main__":
    main()
