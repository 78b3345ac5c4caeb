"""Where the program begins: answers an interrupt before there is anything to interrupt.

Importing this takes a moment; the commands are imported with an interrupt answered in one line,
as it is later on.
"""

from __future__ import annotations

from threadline.cli.interrupt import leaving_on_interrupt


def run() -> None:
    """Run the program with the arguments of the shell."""
    with leaving_on_interrupt():
        from threadline.cli.main import main
    main()


if __name__ == "__main__":
    run()
