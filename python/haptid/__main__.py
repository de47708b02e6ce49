"""`haptid` and `python -m haptid`."""

import atexit
import gc
import sys

# Exit status of a command that was interrupted: 128 and the number of SIGINT, as in a shell.
_INTERRUPTED = 130


def program() -> None:
    """Entry point; Ctrl-C while the commands are still being imported ends without a traceback."""
    # The garbage collector would go through what is imported again and again, a tenth of a command's time.
    gc.set_threshold(300_000, 50, 50)
    # At the end it would go through all of it once more, module by module, before the memory is given back as a whole.
    atexit.register(gc.freeze)
    try:
        from haptid.cli import main as commands

        commands()
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)


if __name__ == "__main__":
    program()
