// As in PaulStoffregen/Servo 1.1.2.
#pragma once
#include "Arduino.h"

class Servo {
 public:
  uint8_t attach(int pin, int min, int max);
  void writeMicroseconds(int value);
  int pulse = 0;  // us; of the model
};
