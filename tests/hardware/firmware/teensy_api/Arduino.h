// What the sketch uses of the Teensy's core library, declared as there (PaulStoffregen/cores, Teensyduino 1.60, teensy4/).
// Defined by ../cortex_m7/sketch_run.cpp.
#pragma once
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define HIGH 1
#define LOW 0
#define INPUT 0
#define OUTPUT 1

uint32_t millis(void);
uint32_t micros(void);
void delayMicroseconds(uint32_t usec);
void delayNanoseconds(uint32_t nsec);
void pinMode(uint8_t pin, uint8_t mode);
void digitalWriteFast(uint8_t pin, uint8_t val);
uint8_t digitalReadFast(uint8_t pin);

class usb_serial_class {
 public:
  void begin(long);
  int available();
  int read();
  int availableForWrite();
  size_t write(const char* buffer, size_t size);
};
extern usb_serial_class Serial;
