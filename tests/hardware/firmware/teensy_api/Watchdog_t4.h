// As in tonton81/WDT_T4 0.1 (1910b57).
#pragma once
#include "Arduino.h"

typedef enum WDT_DEV_TABLE { WDT1 = (uint32_t)0x400B8000 } WDT_DEV_TABLE;

typedef struct WDT_timings_t {
  double timeout = 10;  // s
} WDT_timings_t;

void model_watchdog(double timeout);  // 0: fed

template <WDT_DEV_TABLE _device>
class WDT_T4 {
 public:
  void begin(WDT_timings_t config) { model_watchdog(config.timeout); }
  void feed() { model_watchdog(0); }
};
