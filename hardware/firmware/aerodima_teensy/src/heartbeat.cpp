#include "heartbeat.h"

namespace aerodima {
namespace {

constexpr uint8_t kMagic = 0xAD;

uint8_t check_of(uint8_t second, uint8_t counter) { return static_cast<uint8_t>(~(second ^ counter)); }

}  // namespace

bool decode_beat(const CanFrame& frame, Beat* beat) {
  const uint8_t* d = frame.data;
  if (frame.extended || frame.id != kBeatId || frame.length != 4 || d[0] != kMagic || d[3] != check_of(d[1], d[2])) {
    return false;
  }
  if (d[1] > static_cast<uint8_t>(BeatState::kTrip)) return false;
  beat->state = static_cast<BeatState>(d[1]);
  beat->counter = d[2];
  return true;
}

CanFrame make_answer(uint8_t status, uint8_t counter) {
  CanFrame frame;
  frame.id = kAnswerId;
  frame.length = 4;
  frame.data[0] = kMagic;
  frame.data[1] = status;
  frame.data[2] = counter;
  frame.data[3] = check_of(status, counter);
  return frame;
}

}  // namespace aerodima
