"""API frames against Digi's own library, and streams with noise."""

from digi.xbee.models.address import XBee16BitAddress, XBee64BitAddress
from digi.xbee.packets.common import ReceivePacket, TransmitPacket
from hypothesis import given, settings
from hypothesis import strategies as st

from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.xbee import ApiStream, Packet, make_received, make_transmit
from tests.hardware.fuzzing import fed_in_pieces
from tests.refusals import assert_refused

addresses = st.integers(0, 2**64 - 1)
payloads = st.one_of(
    st.binary(max_size=60),
    st.lists(st.sampled_from([0x7E, 0x7D, 0x11, 0x13, 0x5D]), max_size=20).map(bytes),
)


def digi_address(number):
    return XBee64BitAddress(bytearray(number.to_bytes(8, "big")))


@given(addresses, payloads)
@settings(max_examples=150, deadline=None)
def test_received_frames_are_those_of_the_vendors_library(sender, data):
    theirs = ReceivePacket(
        digi_address(sender), XBee16BitAddress.UNKNOWN_ADDRESS, 1, rf_data=bytearray(data)
    )
    assert make_received(Packet(sender, data)) == bytes(theirs.output(False))
    assert ApiStream().feed(bytes(theirs.output(False))) == [Packet(sender, data)]


@given(addresses, payloads)
@settings(max_examples=150, deadline=None)
def test_frames_to_send_are_those_of_the_vendors_library(receiver, data):
    theirs = TransmitPacket(
        0, digi_address(receiver), XBee16BitAddress.UNKNOWN_ADDRESS, 0, 0, rf_data=bytearray(data)
    )
    assert make_transmit(data, receiver) == bytes(theirs.output(False))


@given(st.binary(max_size=80), st.lists(st.integers(1, 40), min_size=1, max_size=5))
@settings(max_examples=200, deadline=None)
def test_noise_costs_no_good_frame(noise, sizes):
    good = Packet(0x13A20040000001, b"\x02\x07" + bytes(16))
    # Noise may announce a frame of up to 128 bytes that swallows what follows until its checksum
    # fails.
    stream = ApiStream()
    found = fed_in_pieces(stream, noise + 12 * make_received(good), sizes)
    assert len([packet for packet in found if packet == good]) >= 6
    assert len(stream._open) <= 300


def test_every_changed_byte_is_noticed():
    good = Packet(0x13A20040000001, b"\x01\x01" + bytes(range(16)))
    frame = make_received(good)
    for place in range(len(frame)):
        changed = bytearray(frame)
        changed[place] ^= 0x04
        assert ApiStream().feed(bytes(changed)) == []


def test_other_kinds_of_frames_are_skipped():
    modem_status = bytes.fromhex("7E00028A066F")
    good = Packet(1, b"abc")
    stream = ApiStream()
    assert stream.feed(modem_status + make_received(good)) == [good]


def test_too_much_data_is_refused():
    assert_refused(lambda: make_transmit(bytes(300), 1), FrameError, "314")
