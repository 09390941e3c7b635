"""Codecs of users: loaded, rehearsed, and kept from bringing anything down."""

import math
import struct
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from hapticnet.codec import plugins, registry
from hapticnet.codec.plugins import rehearse
from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import CODECS, make_codec, parse_codec, register_installed_codecs, split_codec
from hapticnet.errors import PeerError, SampleError, SettingsError
from hapticnet.node.settings import MasterSettings
from hapticnet.perception import WeberLaw

GOOD = '''
import struct
from dataclasses import dataclass, field
from typing import ClassVar
from hapticnet.perception import WeberLaw

@dataclass(frozen=True)
class Mine:
    """Send each change that exceeds a share of the threshold.

    Attributes
    ----------
    share
        Of the threshold.
    """
    name: ClassVar[str] = "mine"
    needs_position: ClassVar[bool] = False
    law: WeberLaw = field(default_factory=WeberLaw)
    share: float = 1.0

    def encoder(self, axes):
        return Sender(self, axes)

    def decoder(self, axes):
        return Receiver(axes)

class Sender:
    def __init__(self, codec, axes):
        self.codec, self.axes, self.held = codec, axes, None

    def encode(self, t_us, stimulus, position=None):
        if self.held is not None:
            change = max(abs(x - y) for x, y in zip(stimulus, self.held))
            if change <= self.codec.share * self.codec.law.threshold_n(max(map(abs, self.held))):
                return None
        self.held = stimulus
        return struct.pack(f">{self.axes}d", *stimulus)

    def refresh(self):
        self.held = None

class Receiver:
    def __init__(self, axes):
        self.axes, self.held = axes, (0.0,) * axes

    def decode(self, t_us, payload):
        self.held = struct.unpack(f">{self.axes}d", payload)

    def reconstruct(self, t_us, position=None, position_us=None):
        return self.held
'''


@pytest.fixture(autouse=True)
def nothing_registered(monkeypatch, tmp_path):
    monkeypatch.setattr(registry, "_user_codecs", {})
    monkeypatch.setattr(plugins, "_loaded", {})
    monkeypatch.setattr(sys, "path", sys.path[:])
    monkeypatch.chdir(tmp_path)


def load(source, name="mine.py"):
    with open(name, "w") as file:
        file.write(source)
    return parse_codec(f"{name}:Mine")


def test_a_codec_in_a_file_is_used_by_its_name_with_its_parameters():
    load(GOOD)
    name, parameters = parse_codec("mine.py:Mine:share=0.5")
    assert (name, parameters) == ("mine", {"share": 0.5})
    codec = make_codec(name, WeberLaw(multiplier=2.0), parameters)
    encoding = encode_array(codec, np.arange(4) * 1000, np.array([[1.0], [1.04], [1.06], [2.0]]))
    assert encoding.sent.tolist() == [0, 2, 3]
    assert encoding.decoded[:, 0].tolist() == [1.0, 1.0, 1.06, 2.0]
    assert [each["meaning"] for each in registry.describe_codecs()[-1]["parameters"]] == ["Of the threshold."]


def test_a_name_alone_imports_nothing():
    with open("mine.py", "w") as file:
        file.write("raise SystemExit('imported')")
    for name in ("mine.py:Mine", "mine:Mine", "mine"):
        with pytest.raises(SettingsError, match=r"unknown codec .* there are: raw, deadband"):
            make_codec(name, WeberLaw())


def test_an_edited_file_is_read_again():
    import os

    load(GOOD)
    with open("mine.py", "w") as file:
        file.write(GOOD.replace("share: float = 1.0", "share: float = 1.0\n    other: float = 7.0"))
    os.utime("mine.py", ns=(1, 1))
    parse_codec("mine.py:Mine")
    assert make_codec("mine", WeberLaw()).other == 7.0


def test_one_class_may_be_named_in_several_ways(tmp_path):
    load(GOOD, "the_same_codec.py")
    parse_codec("./the_same_codec.py:Mine")
    parse_codec(f"{tmp_path}/the_same_codec.py:Mine")
    assert parse_codec("the_same_codec:Mine:share=2") == ("mine", {"share": 2.0})
    registry._user_codecs.clear()  # so that the module of the working directory is found without the file
    assert parse_codec("the_same_codec:Mine") == ("mine", {})


def test_two_codecs_of_one_name_are_refused():
    load(GOOD)
    with pytest.raises(SettingsError, match=r"codec b\.py:Mine: the name 'mine' is taken by mine\.py:Mine; choose an"):
        load(GOOD, "b.py")
    with pytest.raises(SettingsError, match=r"the name 'raw' is taken by hapticnet"):
        load(GOOD.replace('"mine"', '"raw"'), "c.py")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("class Mine", "class Other"), "mine.py defines no class 'Mine'"),
        (("return struct", "return return"), "importing mine.py raised SyntaxError: invalid syntax"),
        (("import struct\n", "import struct\n1 / 0\n"), r"ZeroDivisionError: division by zero \(mine.py, line 3\)"),
        (("import struct\n", "import struct\nraise SystemExit\n"), "importing mine.py raised SystemExit"),
        (("@dataclass(frozen=True)", "@dataclass"), "not a frozen dataclass"),
        (('name: ClassVar[str] = "mine"', ""), r"needs a class variable name: ClassVar\[str\]"),
        (("name: ClassVar[str]", "name: str"), r"needs a class variable name: ClassVar\[str\]"),
        (('"mine"', '"my codec"'), "name is 'my codec'; use 1 to 64 letters"),
        (("needs_position: ClassVar[bool] = False", ""), "needs a class variable needs_position"),
        (("law: WeberLaw = field(default_factory=WeberLaw)", ""), "has no field law"),
        (("share: float = 1.0", "share: float"), "mine.py raised TypeError"),
        (("share: float = 1.0", "share: str = 'a'"), "parameter share is 'a'; parameters are numbers"),
        (("def encoder", "def coder"), r"has no method encoder\(axes\)"),
        (("share: float = 1.0", "def __post_init__(self): self.x = 1"), "making it raised dataclasses.Frozen"),
        (("self.held = stimulus", "self.held = stimulus[3]"), "rehearsal with 1-axis forces raised IndexError"),
        (('struct.pack(f">{self.axes}d", *stimulus)', "[1]"), r"encode returned \[1\]; it must return bytes"),
        (('d", *stimulus)', 'd", *stimulus) * 1000'), "encode returned 8000 bytes; a payload has at most 1024"),
        (("is not None:", "is None:\n            return None\n        else:"), "must send the first sample; it ret"),
        (("self.held = None\n\nclass", "pass\n\nclass"), r"must send the first sample after refresh\(\)"),
        (("return self.held", "return self.held[0]"), "reconstruct returned 0.0; it must return 1 finite floats as"),
        (("return self.held", "return (float('nan'),)"), r"reconstruct returned \(nan,\)"),
        (("return Sender(self, axes)", "return SENDER"), "raised NameError: name 'SENDER' is not defined"),
        (("Receiver(axes)", "Receiver(1)"), r"reconstruct returned \(0.0,\); it must return 2 finite floats"),
    ],
)
def test_a_broken_codec_is_refused_in_one_sentence(change, message):
    assert change[0] in GOOD
    with pytest.raises(SettingsError, match=message) as refused:
        load(GOOD.replace(*change))
    assert str(refused.value).startswith("codec mine.py:Mine: ")
    assert "\n" not in str(refused.value)


def test_places_that_are_not_there_are_named():
    for source, message in (
        ("none.py:Mine", "codec none.py:Mine: cannot find none.py"),
        ("no_such.module:Mine", "codec no_such.module:Mine: cannot find no_such.module"),
        ("none.py", r"codec 'none.py': name the class in the file too, as in none.py:MyCodec"),
    ):
        with pytest.raises(SettingsError, match=message):
            parse_codec(source)
    assert split_codec("dir/my codec.py:Mine:a=1,b=2") == ("dir/my codec.py:Mine", "a=1,b=2")
    with pytest.raises(SettingsError, match="'step_n' must be KEY=NUMBER"):
        parse_codec("deadband:step_n")


def test_a_codec_may_refuse_more_axes_than_it_knows():
    refusal = "from hapticnet.errors import SampleError\n" + GOOD.replace(
        "return Sender(self, axes)", "if axes > 1: raise SampleError(f'{axes} axes')\n        return Sender(self, axes)"
    )
    load(refusal)
    codec = make_codec("mine", WeberLaw())
    codec.encoder(1)
    with pytest.raises(SettingsError, match=r"codec mine.py:Mine: encoder\(2\) raised SampleError: 2 axes"):
        codec.encoder(2)


def test_what_a_codec_raises_later_becomes_an_error_of_hapticnet():
    load(GOOD.replace("self.held = stimulus", "self.held = stimulus; 1 / (stimulus[0] - 7.0)"))
    codec = make_codec("mine", WeberLaw())
    with pytest.raises(SampleError, match=r"codec mine.py:Mine: encode failed: ZeroDivisionError.*line 36"):
        codec.encoder(1).encode(0, (7.0,))
    encoder = codec.encoder(1)
    encoder._refresh = sys.exit
    with pytest.raises(SampleError, match=r"codec mine.py:Mine: refresh failed: SystemExit"):
        encoder.refresh()
    with pytest.raises(PeerError, match="unpack requires a buffer of 8 bytes"):
        codec.decoder(1).decode(0, b"\x00")
    decoder = codec.decoder(1)
    decoder.decode(0, struct.pack(">d", 2.0))
    assert decoder.reconstruct(0) == (2.0,)
    decoder.decode(0, struct.pack(">d", math.nan))
    with pytest.raises(SampleError, match=r"codec mine.py:Mine: reconstruct failed: .* returned \(nan,\); it must"):
        decoder.reconstruct(0)  # a force that is not finite reaches no device


def test_a_constructor_that_raises_refuses_the_session_only():
    load(GOOD.replace("share: float = 1.0", "share: float = 1.0\n    def __post_init__(self): 1 / self.share"))
    with pytest.raises(SettingsError, match=r"codec 'mine' refused \{'share': 0.0\}: ZeroDivisionError"):
        make_codec("mine", WeberLaw(), {"share": 0.0})


@pytest.mark.parametrize("name", CODECS)
def test_every_codec_of_hapticnet_passes_the_rehearsal(name):
    rehearse(CODECS[name](), name)


def test_codecs_of_installed_packages_are_found_by_name(monkeypatch):
    load(GOOD, "package_of_codecs.py")
    registry._user_codecs.clear()
    named = {"mine": "package_of_codecs:Mine", "yours": "package_of_codecs:Mine", "x": "gone:Mine"}
    points = [SimpleNamespace(name=name, value=value) for name, value in named.items()]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points if group == "hapticnet.codecs" else [])
    assert parse_codec("mine:share=2") == ("mine", {"share": 2.0})
    assert register_installed_codecs() == [
        "codec package_of_codecs:Mine: its entry point is 'yours' and its name 'mine'; make them equal",
        "codec gone:Mine: cannot find gone",
    ]
    with pytest.raises(SettingsError, match="unknown codec 'elsewhere'"):
        make_codec(*parse_codec("elsewhere")[:1], WeberLaw())


def test_master_and_slave_speak_a_codec_of_a_user(loopback):
    load(GOOD)
    link = loopback(settings=MasterSettings(codec="mine", parameters={"share": 0.5}))
    link.run(3_000_000)
    (session,) = link.slave.report()["sessions"]
    assert session["codec"] == "mine"
    assert session["parameters"] == {"share": 0.5}
    assert session["packet_rate_reduction"] > 0.5
    assert session["exceed_jnd_fraction"] == 0.0
