"""What keeps hundreds of runs of commands quick."""

import sys
from unittest import mock

import pytest
import tyro


@pytest.fixture(autouse=True, scope="module")
def _same_command_lines_are_parsed_once():
    """Parsing takes longer than what is tested, and most runs have the same line; refused lines are parsed anew."""
    parse, known = tyro.cli, {}

    def parse_once(kinds, *, prog: str, **how):
        line = prog, *sys.argv[1:]
        if line not in known:
            known[line] = parse(kinds, prog=prog, **how)
        return known[line]

    with mock.patch("tyro.cli", parse_once):
        yield
