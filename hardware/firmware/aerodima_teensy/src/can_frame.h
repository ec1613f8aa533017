// A classic CAN data frame as plain data.
#pragma once
#include <cstdint>

namespace aerodima {

struct CanFrame {
  uint32_t id = 0;         // 11 bits, or 29 with `extended`
  bool extended = false;
  uint8_t length = 0;      // bytes
  uint8_t data[8] = {};
};

}  // namespace aerodima
