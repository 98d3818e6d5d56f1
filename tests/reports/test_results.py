"""Tables of an experiment as HTML and as Markdown."""

from dataclasses import replace

from tests.reports.conftest import Page, Plan

from fbench.replay.data.scores import Column, Curves, Figure, Line, Results, ResultTable
from fbench.reports.html import HtmlReport
from fbench.reports.markdown import markdown, markdown_of_times

TABLE = ResultTable(
    "accuracy", "Accuracy, %", (Column("F1"), Column("fog", "change")),
    (
        Line("late3d", "image", (Figure(0.5, published=0.8358), Figure(-0.25, counts={"clear_tp": 3}))),
        Line("mine", "3D", (Figure(None, "F1 is 0"), Figure(None, "no run"))),
    ),
    ("A note.",),
)  # fmt: skip
RESULTS = Results("The city", (("command", "fbench demo"), ("seeds", "1|2")), (TABLE,), problems=("failed: <b>",))


def test_html_has_the_tables_first_and_the_runs_below(make_run, tmp_path):
    out = tmp_path / "report.html"
    HtmlReport().write_results(RESULTS, [make_run(Plan())], out)
    page = Page(out.read_text("utf-8"))
    for text in ("Accuracy, %", "50.0 83.6", "−25.0", "F1 is 0", "A note.", "failed: <b>", "fbench demo"):
        assert text in page.text
    assert page.text.index("Accuracy, %") < page.text.index("Log digest") < page.text.index("Run digest")
    assert "<b>" not in page.html.partition("failed:")[2][:10]


def test_figures_stay_in_line_where_a_row_has_no_published_one(make_run, tmp_path):
    out = tmp_path / "report.html"
    HtmlReport().write_results(RESULTS, [make_run(Plan())], out)
    table = out.read_text("utf-8").partition('<table class="results">')[2].partition("</table>")[0]
    assert [row.count("<small>") for row in table.split("<tr>")[1:]] == [1, 1, 1]  # beside F1 alone


def test_html_without_results_has_no_such_section(make_run, report):
    assert "Results" not in report(make_run(Plan())).text


def test_markdown():
    text = markdown(RESULTS)
    assert "# The city\n\n- command: `fbench demo`\n- seeds: 1\\|2\n" in text
    assert "| configuration | space | F1 | fog |\n| --- | --- | ---: | ---: |\n" in text
    assert "| late3d | image | 50.0 (83.6) | -25.0 |\n| mine | 3D | – | – |\n" in text
    assert "- F1 of mine 3D: F1 is 0\n" in text
    assert text.endswith("- failed: &lt;b>\n")


def test_markdown_keeps_measured_tables_apart():
    times = ResultTable(
        "latency", "Latency by stage, ms", (Column("total", "ms"),), (Line("mine", "", (Figure(4.0),)),)
    )
    results = replace(RESULTS, measured=(times,))
    assert markdown(results) == markdown(RESULTS)
    text = markdown_of_times(results)
    assert text.startswith("# The city: times\n\n## Latency by stage, ms\n")
    assert "| mine |" in text
    assert "4.00" in text


def test_markdown_keeps_names_names_from_data_on_their_line_and_fetches_nothing_for_them():
    line = replace(TABLE.lines[0], name="a\n# b|c![](http://x/y.png)\\[")
    text = markdown(replace(RESULTS, tables=(replace(TABLE, lines=(line,)),)))
    assert r"| a # b\|c!\[](http://x/y.png)\\\[ | image |" in text


def test_curves_over_severity(make_run, tmp_path):
    """The field is 220 wide from 30 on, and 112 high from 120 up to 8; where a figure is missing, a line breaks."""
    whole = Line("late3d", "3D", tuple(Figure(v, low=v - 0.1, high=v + 0.1) for v in (0.75, 0.5, 0.25)))
    curves = Curves(
        "fog", ("clear", "1", "5"), (whole, Line("<b>", "3D", (Figure(1.0), Figure(None, "x"), Figure(0.0))))
    )
    out = tmp_path / "report.html"
    HtmlReport().write_results(replace(RESULTS, curves=(curves,)), [make_run(Plan())], out)
    chart = out.read_text("utf-8").partition("<figcaption>fog")[2].partition("</figure>")[0]
    assert 'aria-label="fog. late3d: clear 75.0, 1 50.0, 5 25.0; &lt;b&gt;: clear 100.0, 1 –, 5 0.0"' in chart
    assert '<polyline points="30.0,36.0 140.0,64.0 250.0,92.0"/>' in chart
    assert '<polygon points="30.0,47.2 140.0,75.2 250.0,103.2 250.0,80.8 140.0,52.8 30.0,24.8"/>' in chart
    assert [chart.count(f'<polyline points="{at}"/>') for at in ("30.0,8.0", "250.0,120.0")] == [1, 1]
    assert chart.count("<polygon") == 1
