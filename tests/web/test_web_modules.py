"""The page's modules that compute: messages, history, clock, shapes and texts, run in a browser."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from hapticnet.operator.live import HandState
from hapticnet.web import messages

pytest.importorskip("playwright")
from tests.web.staged import ORIGIN, Stage, serve_files


@pytest.fixture(scope="module")
def run_module(chromium) -> Iterator[Callable[..., Any]]:
    """Return what runs a function that gets all exports of one module."""
    stage = Stage(chromium.new_page())
    serve_files(stage.page, stage)
    stage.page.goto(f"{ORIGIN}/static/icon.svg")

    def run(module: str, code: str, argument: Any = None) -> Any:
        load = f"const m = await import('/static/{module}.js');"
        return stage.page.evaluate(f"async (argument) => {{ {load} return ({code})(m, argument); }}", argument)

    yield run
    stage.page.close()


DECODE = """(m, bytes) => {
  const message = m.decode(Uint8Array.from(bytes).buffer);
  return message && JSON.parse(JSON.stringify(message, (_, v) => ArrayBuffer.isView(v) ? [...v] : v));
}"""


def test_a_page_reads_what_the_server_writes(run_module):
    frame = messages.frame(HandState.HOLDING, 7, 12.5, 0.25, (0.25, 0.5), (1, 2))
    assert run_module("wire", DECODE, list(frame)) == {
        "kind": "frame", "handState": "holding", "number": 7, "handTimeMs": 12.5, "tipM": 0.25,
        "surfacesM": [0.25, 0.5], "contacts": [1, 2], "further": [],
    }  # fmt: skip
    of_three_axes = messages.frame(HandState.LIVE, 7, 12.5, 0.25, (), (), (0.5, -0.25, 1.0, 2.0, 3.0))
    assert run_module("wire", DECODE, list(of_three_axes))["further"] == [0.5, -0.25, 1.0, 2.0, 3.0]
    samples = messages.samples(2**33 - 1, 1.5, np.arange(6.0).reshape(2, 3))
    assert run_module("wire", DECODE, list(samples)) == {
        "kind": "samples", "rows": 3, "firstRow": 2**32 - 1, "startS": 1.5, "columns": [[0, 1, 2], [3, 4, 5]]
    }  # fmt: skip

    assert run_module("wire", DECODE, list(messages.vibration([0.5, -2.0]))) == {
        "kind": "vibration", "playedMS2": [0.5, -2.0]
    }  # fmt: skip
    assert run_module("wire", DECODE, list(messages.vibration([0.5, -2.0])[:-1])) is None
    for message in (frame, samples):
        assert [run_module("wire", DECODE, list(message[:kept])) for kept in (0, 1, 15, 19, 25)] == [None] * 5


HEAR = """(m, calls) => {
  const heard = [];
  globalThis.AudioBufferSourceNode = class {
    constructor(_, { buffer }) { this.buffer = buffer; }
    connect() {}
    start(at) { heard.push([at, [...this.buffer.getChannelData(0)]]); }
  };
  const tone = new m.Tone();
  tone.vibrate([1]);  // off until it is switched on
  tone._context = { state: "running", currentTime: 0, destination: null };
  for (const samples of calls) tone.vibrate(samples);
  return heard;
}"""


def test_vibration_is_heard_without_gaps_and_never_louder_than_the_tone(run_module):
    heard = run_module("sound", HEAR, [[1.0, 2.0], [1e6, -1e6], []])
    assert len(heard) == 2
    (first_s, first), (second_s, second) = heard
    assert second_s - first_s == pytest.approx(2 / 2800, rel=1e-6)
    assert first == pytest.approx(0.12 / 20.0 * np.array([1 / 3, 2 / 3, 1.0, 4 / 3, 5 / 3, 2.0]), rel=1e-5)
    assert max(map(abs, second)) == pytest.approx(0.12)


def test_the_server_reads_hands_as_a_page_writes_them(run_module):
    data = run_module("wire", "(m) => [...new Uint8Array(m.encodeHand([0.015625, 0.5], 1234.5))]")
    assert messages.parse_binary(bytes(data)) == messages.Hand((0.015625, 0.5), 1234.5)


def test_the_history_keeps_the_newest_rows_in_order_and_counts_those_that_are_missing(run_module):
    code = """(m) => {
      const history = new m.History(["held"], 10);
      let row = 0;
      for (const [rows, gap] of [[3, 0], [4, 0], [9, 0], [2, 5], [25, 0], [1, 0]]) {
        row += gap;
        const numbers = Float32Array.from({ length: rows }, (_, k) => row + k);
        const message = { rows, firstRow: row, startS: row, columns: [numbers.map((n) => n - row), numbers] };
        history.append(message, ["t", "held"]);
        row += rows;
      }
      const late = new m.History([], 10);  // beyond 32 bits
      for (const firstRow of [2 ** 32 - 2, 0]) {
        late.append({ rows: 2, firstRow, startS: 0, columns: [new Float32Array(2)] }, ["t"]);
      }
      return [[...history.column("held")], [...history.time], history.missed, history.last("held"), late.missed];
    }"""
    held, time, missed, last, missed_late = run_module("history", code)
    assert held == time == list(range(39, 49))
    assert (missed, last, missed_late) == (5, 48, 0)


def test_the_time_of_the_plot_runs_evenly_although_messages_do_not(run_module):
    code = """(m) => {
      const clock = new m.Clock();
      const shown = [];
      for (let k = 0; k < 300; k += 1) {
        const now = k / 60;
        if (k % 3 !== 1) clock.observe(100 + now - (k % 5) * 0.004, now);
        shown.push(clock.now(now));
      }
      return shown;
    }"""
    steps = np.diff(run_module("clock", code)[60:])
    assert steps.min() > 0.5 / 60
    assert steps.max() < 1.5 / 60


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ("[newtons(-0.001), newtons(-1.5), newtons(NaN)].join('; ')", "0.00 N; −1.50 N; –"),
        ("[999, 1344, 62000, 2.5e6].map((n) => bytes(n).join(' ')).join('; ')", "999 B; 1.3 kB; 62 kB; 2.5 MB"),
        ("[0.9812, 1, 0.5].map(percent).join('; ')", "98.1; 100; 50"),
        ("[0.00123, 0.0456, 1.2345].map((n) => joules(n).join(' ')).join('; ')", "1.2 mJ; 46 mJ; 1.23 J"),
        ("thresholdWords(2, 0.05, 0.025)", "Changes within 100\u00a0mN of 1\u00a0N are not sent"),
        ("handWords('page', 'another', 'live')", "Another page moves the needle"),
        ("linkState('stale').join(' ')", "warn Link stale"),
        (
            "firstSentence({ known: true, axes: 1, tissues: [{ name: 'wall' }] }, '')",
            "A needle, elsewhere on the network, enters one layer of tissue (wall); it pushes back until it breaks.",
        ),
        (
            "firstSentence({ axes: 2, name: 'mujoco:m', parts: ['force@a', 'grip'] }, 'a box').replace(/, as.*ws/, '')",
            (
                "A tool, elsewhere on the network, moves on two axes among a box of a MuJoCo model;"
                " what it touches pushes back. It has 2 parts; you see the first, force at a."
            ),
        ),
        ("handSentence('page', 'you', 'tool')", "The ring is your hand; the tool follows it."),
        ("handSentence('haply', 'nobody', 'tool')", "Another program is the hand."),
        ("bandSentence('raw')", "Every force is sent, so there is no band, and no packet is saved."),
        ("codecWords('mine', 'as I like')", "as I like"),
    ],
)
def test_numbers_and_states_in_words(run_module, call: str, text: str):
    names = "newtons, bytes, joules, percent, thresholdWords, handWords, linkState"
    names += ", firstSentence, handSentence, bandSentence, codecWords"
    assert run_module("words", f"({{ {names} }}) => {call}") == text
