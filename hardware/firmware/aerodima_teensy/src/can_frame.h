// A classic CAN data frame as plain data, and what every file of the core needs.
//
// The core is built from C headers only: no C++ library has to be there for it.
#pragma once

// Products and sums are rounded one by one, as on the computer: the Teensy's numbers are those of the tests bit for bit.
#ifdef __arm__
#pragma GCC optimize("fp-contract=off")
#endif

#include <stdint.h>

namespace aerodima {

struct CanFrame {
  uint32_t id = 0;         // 11 bits, or 29 with `extended`
  bool extended = false;
  uint8_t length = 0;      // bytes
  uint8_t data[8] = {};
  uint32_t made = 0;       // ms, on the clock of the core that made it
};

template <class T>
constexpr T smaller(T one, T other) {
  return other < one ? other : one;
}

template <class T>
constexpr T larger(T one, T other) {
  return one < other ? other : one;
}

}  // namespace aerodima
