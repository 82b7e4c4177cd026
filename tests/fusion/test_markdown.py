"""What somebody called a folder or a pair is shown as it is by a page of Markdown."""

from urllib.parse import unquote

import markdown as python_markdown
import pytest

from adagmm_fusion.files.markdown import link, plain

NAMES = ["a|b", "*bold*", "`code`", "[x](y)", "<b>", "back\\slash", "00284_to_00289", "Büro 漢", "\\*", "a]b c"]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_data(name):
    table = f"| name | n |\n|:--|--:|\n| {plain(name)} | 1 |"
    html = python_markdown.markdown(table, extensions=["tables"])
    shown = name.replace("<", "&lt;").replace(">", "&gt;")
    assert f"{shown}</td>" in html and html.count("<td") == 2


@pytest.mark.parametrize(("name", "shown"), [("a\nb", r"a\\nb"), ("a\x1b[0m", r"a\\x1b\[0m"), ("\ud800", r"\\ud800")])
def test_control_characters_are_visible(name, shown):
    assert plain(name) == shown


@pytest.mark.parametrize("name", NAMES)
def test_a_link_leads_to_its_path(name):
    html = python_markdown.markdown(link(f"{name}/report.md"))
    target = html.split('href="')[1].split('"')[0]
    assert unquote(target) == f"{name}/report.md"
