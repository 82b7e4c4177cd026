"""A file of `run`'s settings: YAML, one setting a line, as `--dump-config` prints it and `--config` takes it."""

import argparse
from collections.abc import Mapping, Sequence

from adagmm_o3d.errors import InputError

OPTION = "--config"


def config_text(settings: Mapping[str, object]) -> str:
    """The file's text for settings by their names; those that are None are comments, as they have no value to write."""
    lines = [f"# {name}: chosen as fits" if value is None else f"{name}: {value}" for name, value in settings.items()]
    return "\n".join(["# adagmm-fusion run RECORDING --config THIS_FILE", *lines, ""])


def with_config(arguments: Sequence[str], options: Mapping[str, str]) -> list[str]:
    """A command's arguments with the settings of its --config file before the rest, so that the rest overrides them.

    Parameters
    ----------
    arguments : of the command line, the command's name first.
    options : the option of each setting's name.

    Raises
    ------
    InputError  if the file cannot be read, or holds something else; file and line are named.
    """
    looking = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    looking.add_argument(OPTION)
    file = looking.parse_known_args(arguments[1:])[0].config
    if file is None:
        return list(arguments)
    from adagmm_fusion.files.strict_yaml import read_yaml

    found = read_yaml(file, InputError).mapping(optional=tuple(options))
    return [arguments[0], *(f"{options[name]}={item.text()}" for name, item in found.items()), *arguments[1:]]
