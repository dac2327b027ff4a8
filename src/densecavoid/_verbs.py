"""Commands with verbs of their own, such as `densecavoid perceive evaluate`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

Verb = Callable[[Sequence[str]], None]
"""Takes the arguments behind it; its docstring is its line of help."""


def run_verb(command: str, verbs: Mapping[str, Verb], args: Sequence[str]) -> None:
    """Calls the verb that the first argument names with the others, or says what there is.

    Args:
        command: as it is typed, for the help.
        verbs: by name.
        args: behind the command.

    Raises:
        ValueError: for an unknown verb, with the help.
    """
    if args and args[0] in verbs:
        verbs[args[0]](args[1:])
        return
    wanted = "\n".join(f"  {name:16} {verb.__doc__}" for name, verb in verbs.items())
    usage = f"usage: {command} WHAT [options]\n\n{wanted}"
    if args and args[0] not in ("-h", "--help"):
        raise ValueError(f"unknown {args[0]!r}\n{usage}")
    print(usage)


@contextmanager
def needing_torch(what: str) -> Iterator[None]:
    """Turns a failed import into what to install. `what` begins the sentence."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise ValueError(f"{what} needs {error.name}: pip install 'densecavoid[train]'") from None
