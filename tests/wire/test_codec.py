"""Every message comes back as it was sent; whatever is not one is refused with a sentence."""

import math
import zlib
from dataclasses import fields, replace
from typing import get_args

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.errors import WireError
from dppo.store.contents import SNAPSHOT_FORM
from dppo.wire import messages
from dppo.wire.codec import MAX_BODY, MAX_HEADER, Frame, decode, encode, sealed, unsealed
from dppo.wire.messages import VERSION, Message

PLACE = {"generation": 1, "iteration": 4, "round": 2}
WIDE = np.array([0.5, -0.0, math.inf, math.nan, 5e-324])
NARROW = np.array([1.5, -0.0, math.nan], np.float32)
EMPTY = np.empty(0)

EXAMPLES: list[Message] = [
    messages.Hello(
        worker="w-3f2a", host="lab1", pid=7, numerics="9c1e", versions="mujoco 4.0.0",
        served_run="5b7d", served_generation=2,
    ),
    messages.Ready(
        worker="w", generation=1, obs_size=27, action_kind="box", action_sizes=(8,),
        env_hash="5d41", exact="captured",
    ),
    messages.Collected(
        worker="w", **PLACE, slot=3, obs=WIDE, returns=WIDE[:3], advantages=EMPTY, fit=WIDE[1:],
        reward=WIDE[2:], sigma_target=WIDE[:1], start_sigma=WIDE[::2], episodes=EMPTY, exact=True,
        snapshot=b"\x00\xff{",
    ),
    messages.Gradient(
        worker="w", **PLACE, first=4, size=4, stopped=(5, 7), vector=NARROW, sums=WIDE
    ),
    messages.Measured(worker="w", **PLACE, first=2, size=2, kls=WIDE[:2], weights=WIDE[1:]),
    messages.Alive(worker="w", generation=1, done=48211),
    messages.Failure(worker="w", generation=1, slot=3, usage=False, reason="slot 3, env 1 …"),
    messages.Welcome(run="3f9c", generation=1, config='{"run": {}}', name="main"),
    messages.Restore(generation=1, iteration=4, slot=3, snapshot=b""),
    messages.Collect(
        **PLACE, slots=(0, 1), psi=0.1, beta=1.0, mean_reward=2.5, parameters=NARROW, obs=WIDE,
        returns=WIDE[:3], sigma_target=WIDE[:3],
    ),
    messages.Update(**PLACE, slots=(), stopped=(), parameters=NARROW[:0], advantages=WIDE),
    messages.Measure(**PLACE, slots=(0, 4095), parameters=NARROW),
    messages.Stop(reason="finished", final=True),
]  # fmt: skip
GRADIENT, STOP = EXAMPLES[3], EXAMPLES[-1]


def bits(message):
    """A message as values that compare, not-a-number and the sign of zero included."""
    return type(message), [
        (value.dtype.str, value.tobytes())
        if isinstance(value, np.ndarray)
        else (type(value), value)
        for value in (getattr(message, field.name) for field in fields(message))
    ]


def framed(name, values, body=b"", version=VERSION):
    return Frame(msgpack.packb([version, name, values]), body)


def refused(frame, sentence):
    with pytest.raises(WireError, match=sentence):
        decode(frame)


def test_every_message_has_an_example():
    assert {type(example) for example in EXAMPLES} == set(get_args(Message))


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_a_message_comes_back_to_the_bit(message):
    frame = encode(message)
    again = decode(Frame(bytes(frame.header), bytes(frame.body)))
    assert bits(again) == bits(message)
    assert encode(again) == frame


def test_a_decoded_vector_is_writable_and_keeps_nothing_of_the_frame():
    body = bytearray(encode(GRADIENT).body)
    decoded = decode(Frame(encode(GRADIENT).header, body))
    assert isinstance(decoded, messages.Gradient)
    body[:] = bytes(len(body))
    assert decoded.vector.tobytes() == NARROW.tobytes()
    decoded.vector[0] = 7


def test_vectors_travel_in_their_declared_width():
    sent = messages.Measure(**PLACE, slots=(), parameters=np.array([1.0, 2.0]))
    again = decode(encode(sent))
    assert isinstance(again, messages.Measure)
    assert again.parameters.dtype == np.float32
    assert len(encode(sent).body) == 8


def test_the_body_is_the_little_endian_bytes_one_after_the_other():
    assert bytes(encode(GRADIENT).body) == (
        NARROW.astype("<f4").tobytes() + WIDE.astype("<f8").tobytes()
    )


@pytest.mark.parametrize(
    "header",
    [b"", b"\xc1", b"junk and more junk", b"\x93\x01", b"\xdd\xff\xff\xff\xff", b"\xdb\xff\xff"],
)
def test_what_is_not_msgpack_is_refused(header):
    refused(Frame(header, b""), "a header is not")


@pytest.mark.parametrize(
    "header",
    [
        [], [VERSION], [VERSION, "Stop"], [VERSION, "Stop", "x"], ["1", "Stop", []],
        [VERSION, 7, []], [VERSION, "Stop", [], 0], 7, "Stop", None, [1.0, "Stop", ["x", True]],
        [True, "Stop", ["x", True]],
    ],
)  # fmt: skip
def test_a_header_of_another_form_is_refused(header):
    refused(Frame(msgpack.packb(header), b""), "a header is not .version, message name, field")


def test_a_version_means_one_form_of_every_message():
    frames = [encode(message) for message in EXAMPLES]
    travelled = zlib.crc32(b"".join(frame.header + frame.body for frame in frames))
    spoken = VERSION, SNAPSHOT_FORM, travelled
    assert spoken == (5, 3, 2435672134), "another protocol needs another VERSION"


@pytest.mark.parametrize("version", [0, 1, VERSION + 1, -1, 2**63])
def test_another_version_is_refused_with_advice(version):
    sentence = f"protocol version {version}, this process speaks {VERSION}; install the same dppo"
    refused(framed("Alive", ["w", 1, 48211], version=version), sentence)
    for values in ([], ["x", True], ["x", True, False, 7]):
        refused(framed("Stop", values, version=version), sentence)


@pytest.mark.parametrize("version", [0, 1, VERSION + 1])
def test_hello_and_stop_of_any_version_are_understood(version):
    """What is written here stays as it is, whatever becomes of the other messages."""
    said = framed("Hello", ["w-3f", "lab1", 7, "9c1e", "mujoco 4", "5b7d", 2, 9], version=version)
    assert decode(said) == messages.Hello(
        worker="w-3f", host="lab1", pid=7, numerics="9c1e", versions="mujoco 4",
        served_run="5b7d", served_generation=2, protocol=9,
    )  # fmt: skip
    assert decode(framed("Stop", ["no", True, True], version=version)) == messages.Stop(
        reason="no", final=True, sent_away=True
    )


@pytest.mark.parametrize("name", ["", "Quit", "stop", "Message", "__class__", "Stop" * 30])
def test_an_unknown_message_is_refused_by_name(name):
    refused(framed(name, ["x", True]), f"'{name[:40]}' is no message of this protocol")


@pytest.mark.parametrize("values", [[], ["x"], ["x", True, True, 1]])
def test_a_missing_or_extra_field_is_refused(values):
    refused(framed("Stop", values), f"Stop has {len(values)} fields, expected 3")


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("Stop", [3, True, False], "Stop.reason is a int, expected str"),
        ("Stop", ["x", 1, False], "Stop.final is a int, expected bool"),
        ("Stop", ["x", None, False], "Stop.final is a NoneType, expected bool"),
        (
            "Collect",
            [1, 4, 2, [0], 1, 1.0, 2.5, 0, 0, 0, 0],
            "Collect.psi is a int, expected float",
        ),
        ("Measured", ["w", True, 4, 2, 2, 2, 0, 0], "Measured.generation is a bool"),
        ("Measured", ["w", 1.0, 4, 2, 2, 2, 0, 0], "Measured.generation is a float"),
        ("Measured", [["w"], 1, 4, 2, 2, 2, 0, 0], "Measured.worker is a list, expected str"),
        ("Measure", [1, 4, 2, 7, 0], "Measure.slots is int, expected a list of whole numbers"),
        ("Measure", [1, 4, 2, [0, True], 0], "Measure.slots is list, expected a list of whole"),
        ("Measure", [1, 4, 2, [0, [1]], 0], "Measure.slots is list, expected a list of whole"),
        ("Restore", [1, 4, 3, -1], "Restore.snapshot has length -1, expected a whole number >= 0"),
        ("Restore", [1, 4, 3, 1.0], "Restore.snapshot has length 1.0, expected a whole number"),
        ("Restore", [1, 4, 3, True], "Restore.snapshot has length True, expected a whole number"),
        ("Restore", [1, 4, 3, "abc"], "Restore.snapshot has length 'abc', expected a whole"),
    ],
)
def test_a_field_of_another_type_is_refused_by_name(name, values, sentence):
    refused(framed(name, values), sentence)


NAMES = ["", "*", "**", "a?b", "a#b", "a//b", "a/", "../x", "x" * 65, "w1\n", "ä"]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_means_something_in_a_key_is_refused_whatever_the_message(name):
    for message in EXAMPLES[:7]:
        frame = encode(replace(message, worker=name))
        refused(frame, "of a worker called .*: letters, digits and '-' only")


@pytest.mark.parametrize("length", [1 << 31, 1 << 60, (1 << 64) - 1])
def test_a_huge_length_is_held_against_the_body_before_anything_is_allocated(length):
    refused(framed("Restore", [1, 4, 3, length], b"ab"), f"{length} of a body of 2 bytes")
    refused(framed("Measure", [1, 4, 2, [], length], b"ab"), f"{4 * length} of a body of 2 bytes")


def test_a_body_of_another_size_is_refused():
    frame = encode(GRADIENT)
    refused(Frame(frame.header, frame.body[:-1]), "Gradient.sums ends at byte 52 of a body of 51")
    refused(Frame(frame.header, frame.body + b"x"), "Gradient accounts for 52 of 53 bytes")
    refused(Frame(encode(STOP).header, b"x"), "Stop accounts for 0 of 1 bytes")


@pytest.mark.parametrize(
    "value", [msgpack.ExtType(1, b"x"), msgpack.Timestamp(0), {}, {1: 2}, b"x"]
)
def test_ext_types_maps_and_binaries_have_no_place_in_a_header(value):
    refused(framed("Stop", [value, True, False]), "a header is not msgpack|Stop.reason is a dict")


@pytest.mark.parametrize(
    "header",
    [b"\x91" * 100_000 + b"\xc0", b"\x93\x01\xa4Stop" + b"\x91" * 2000, b"\xdc\xff\xff" * 10_000],
)
def test_nested_bombs_are_refused(header):
    refused(Frame(header, b""), "a header is not")


def test_oversized_frames_are_refused_unread():
    sentence = f"at most {MAX_HEADER} \\+ {MAX_BODY} are accepted"
    refused(Frame(bytes(MAX_HEADER + 1), b""), sentence)
    refused(Frame(b"", bytes(MAX_BODY + 1)), sentence)


def message_or_wire_error(frame):
    """Decode; anything but a message or a WireError fails the test."""
    try:
        return decode(frame)
    except WireError as error:
        assert str(error)  # noqa: PT017
        return None


fuzz = settings(deadline=None, max_examples=100)
frames = st.sampled_from([encode(example) for example in EXAMPLES])


@fuzz
@given(st.binary(max_size=60), st.binary(max_size=20))
def test_random_bytes_are_a_message_or_a_wire_error(header, body):
    message_or_wire_error(Frame(header, body))


@fuzz
@given(frames, st.data())
def test_a_mutated_frame_is_a_message_or_a_wire_error(frame, data):
    header, body = bytearray(frame.header), bytearray(frame.body)
    for part in (header, body):
        for _ in range(data.draw(st.integers(0, 3))):
            at = data.draw(st.integers(0, max(len(part) - 1, 0)))
            part[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
    decoded = message_or_wire_error(Frame(bytes(header), bytes(body)))
    if decoded is not None:
        assert bits(decode(encode(decoded))) == bits(decoded)


scalars = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats()
values = st.recursive(
    scalars | st.text("ab", max_size=3), lambda v: st.lists(v, max_size=3), max_leaves=6
)


@fuzz
@given(st.sampled_from([type(example).__name__ for example in EXAMPLES]), st.data())
def test_any_field_values_are_a_message_or_a_wire_error(name, data):
    count = len(fields(getattr(messages, name)))
    chosen = data.draw(st.lists(values, min_size=count, max_size=count))
    message_or_wire_error(framed(name, chosen, data.draw(st.binary(max_size=12))))


def test_a_frame_that_was_damaged_is_refused_whichever_byte_it_was():
    frame = Frame(framed("Stop", ["x", True]).header, bytes(range(200)))
    sent = sealed(frame)
    assert unsealed(sent, bytes(frame.body)) == frame
    for place in range(len(sent) + len(frame.body)):
        damaged = bytearray(sent + frame.body)
        damaged[place] ^= 0x10
        with pytest.raises(WireError, match="do not match their checksum"):
            unsealed(bytes(damaged[: len(sent)]), bytes(damaged[len(sent) :]))
    with pytest.raises(WireError, match=r"0 \+ 0 bytes do not match"):
        unsealed(b"", b"")
