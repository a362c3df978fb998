"""The command line before it is parsed: other tools' habits, presets, files, addresses."""

from collections.abc import Collection, Mapping
from pathlib import Path

from dppo.config import Config
from dppo.errors import UsageError
from dppo.wire.addresses import check_address, is_loopback


def normalised(
    argv: list[str], aliases: Mapping[str, str], whole_numbers: Collection[str]
) -> list[str]:
    """`--a_b=1e6` as `--a-b 1000000`, and other tools' names of a flag as ours."""
    words: list[str] = []
    for word in argv:
        if not word.startswith("-") or _is_number(word):
            words.append(_whole(word) if words and words[-1] in whole_numbers else word)
            continue
        flag, equals, value = word.partition("=")
        flag = flag.replace("_", "-")
        words.append(aliases.get(flag, flag))
        if equals:
            words.append(_whole(value) if words[-1] in whole_numbers else value)
    return words


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _whole(word: str) -> str:
    """1e6 as 1000000; anything else as it is, for the parser to judge."""
    if "e" not in word.lower() or not _is_number(word):
        return word
    number = float(word)
    return str(int(number)) if number.is_integer() else word


def defaults(argv: list[str]) -> Config:
    """What --preset and --config make of the defaults; the parser sees both flags again.

    Raises:
        UsageError: no such preset, or a file that is no config file.
    """
    from dppo.presets import PRESETS
    from dppo.store.run_directory import read_config

    preset, file = _value(argv, "--preset"), _value(argv, "--config")
    if preset is not None and file is not None:
        raise UsageError("--preset and --config both set all defaults; give one of them")
    if file is not None:
        return read_config(Path(file))
    if preset is not None and preset not in PRESETS:
        raise UsageError(f"--preset is {preset!r}, expected one of {', '.join(PRESETS)}")
    return PRESETS[preset or "default"](_value(argv, "--env") or Config().run.env)


def _value(argv: list[str], flag: str) -> str | None:
    """The word behind `flag`."""
    if flag not in argv:
        return None
    at = len(argv) - argv[::-1].index(flag)  # the last one counts, as for the parser
    if at >= len(argv):
        raise UsageError(f"{flag} needs a value")
    return argv[at]


def listening_address(listen: str, insecure: bool) -> str:
    """The address to listen on.

    Raises:
        UsageError: it is no address, or beyond loopback without --insecure.
    """
    from learner.local import free_address

    if listen == "auto":
        return free_address()
    check_address("--listen", listen)
    if not insecure and not is_loopback(listen):
        raise UsageError(
            f"--listen {listen} is open to other machines, without encryption or authentication; "
            "add --insecure if that network is yours alone, or listen on tcp/127.0.0.1:7447"
        )
    return listen
