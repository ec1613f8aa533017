// The computer's heartbeat on the bus and the Teensy's answer; the same bytes as hardware/car/bus_watch.py.
//
// Neither can be taken for a frame of a motor: motor ids end at 3F and their commands have 8 bytes.
#pragma once
#include "can_frame.h"

namespace aerodima {

constexpr uint32_t kBeatId = 0x7A0, kAnswerId = 0x7A1;
constexpr uint8_t kMaxAhead = 64;  // most counts from one beat to the next, as hardware/devices/radio_link.py has it

enum class BeatState : uint8_t { kOff = 0, kArmed = 1, kTrip = 2 };

struct Beat {
  BeatState state = BeatState::kOff;
  uint8_t counter = 0;
};

// False for any other frame.
bool decode_beat(const CanFrame& frame, Beat* beat);

// status: of the Teensy; counter: of the beat that is answered.
CanFrame make_answer(uint8_t status, uint8_t counter);

}  // namespace aerodima
