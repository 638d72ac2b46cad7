"""`python -m pepperscene` is the command line."""

from __future__ import annotations

from pepperscene.cli import main

if __name__ == "__main__":
    main()
