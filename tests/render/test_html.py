"""The text of the page."""

import html
import re
from dataclasses import replace

import pytest

from mapf_pz.render.recording import html_page, save_html
from tests.helpers.small_recording import RECORDING


def test_the_page_loads_nothing_and_shows_no_foreign_tags(tmp_path):
    save_html(RECORDING, tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text().replace('xmlns="http://www.w3.org/2000/svg"', "")
    assert not re.search(r"https?://|src=|@import|url\(", page)
    assert "<b>title" not in page
    assert "a &lt;b&gt;title" in page


def test_text_that_looks_like_a_template_is_unchanged(tmp_path):
    save_html(replace(RECORDING, title="{{script}}", facts={"</script>": "{{data}}"}), tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert "<title>{{script}}</title>" in page
    assert page.count("</script>") == 2


def test_a_notebook_shows_the_page_in_a_frame():
    frame = RECORDING._repr_html_()
    srcdoc = re.search('srcdoc="([^"]*)"', frame)[1]
    assert html.unescape(srcdoc) == html_page(RECORDING)


def test_no_recording():
    with pytest.raises(ValueError, match="expected at least one recording"):
        html_page([])


@pytest.mark.parametrize(("fps", "speed"), [(None, 4), (0.1, 1), (5, 4), (7, 8), (1000, 64)])
def test_the_speed_is_the_nearest_of_the_page(tmp_path, fps, speed):
    save_html(RECORDING, tmp_path / "a.html", *([] if fps is None else [fps]))
    text = (tmp_path / "a.html").read_text("utf-8")
    assert re.findall(r'"speed": ?(\d+)', text) == [str(speed)]
    assert text == html_page(RECORDING, *([] if fps is None else [fps]))
