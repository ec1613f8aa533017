// The Teensy of the car: pins, serial port and CAN controller around the core in src/.
//
// `config.h` is written by `aerodima firmware FOLDER`, from the parameters of the project.
// Libraries: FlexCAN_T4, Servo, WDT_T4 (all for Teensy 4).

#include <FlexCAN_T4.h>
#include <Servo.h>
#include <Watchdog_t4.h>

#include "config.h"
#include "src/core.h"

namespace {

constexpr int kServoPin = 2, kThrottlePin = 3;
constexpr int kEncoderSelect = 10, kEncoderData = 12, kEncoderClock = 13;
constexpr uint32_t kEncoderPeriodUs = 1000;  // 1 kHz, thesis 5.4.5
constexpr uint32_t kCanBitrate = 1000000;
constexpr float kResetAfterS = 0.5f;  // the processor's own watchdog: the outputs start neutral again

FlexCAN_T4<CAN1, RX_SIZE_256, TX_SIZE_64> can_bus;
WDT_T4<WDT1> processor_watchdog;
Servo servo, throttle;
aerodima::TeensyCore* core;
uint32_t encoder_time;

uint32_t read_encoder() {  // synchronous serial: the most significant bit first, one per falling clock edge
  uint32_t word = 0;
  digitalWriteFast(kEncoderSelect, LOW);
  delayMicroseconds(1);
  for (int bit = 0; bit < AERODIMA_SAIL_BITS; ++bit) {
    digitalWriteFast(kEncoderClock, LOW);
    delayNanoseconds(500);
    digitalWriteFast(kEncoderClock, HIGH);
    delayNanoseconds(500);
    word = word << 1 | digitalReadFast(kEncoderData);
  }
  digitalWriteFast(kEncoderSelect, HIGH);
  return word;
}

void receive_frames() {
  CAN_message_t message;
  while (can_bus.read(message)) {
    if (message.flags.remote) continue;
    aerodima::CanFrame frame;
    frame.id = message.id;
    frame.extended = message.flags.extended;
    frame.length = message.len;
    memcpy(frame.data, message.buf, sizeof frame.data);
    core->receive(frame);
  }
}

// One frame after the other (`seq`), or an exit frame could be overtaken by the command before it; one that the driver
// does not take waits for the next turn.
void send_frames() {
  static aerodima::CanFrame frame;
  static bool waits = false;
  while (waits || core->next_frame(&frame)) {
    CAN_message_t message;
    message.id = frame.id;
    message.len = frame.length;
    message.seq = 1;
    memcpy(message.buf, frame.data, sizeof frame.data);
    waits = can_bus.write(message) <= 0;
    if (waits) return;
  }
}

}  // namespace

void setup() {
  pinMode(kEncoderSelect, OUTPUT);
  pinMode(kEncoderClock, OUTPUT);
  pinMode(kEncoderData, INPUT);
  digitalWriteFast(kEncoderSelect, HIGH);
  digitalWriteFast(kEncoderClock, HIGH);
  Serial.begin(115200);  // USB ignores the rate
  const aerodima::Config config = aerodima_config();
  can_bus.begin();
  can_bus.setBaudRate(kCanBitrate);
  core = new aerodima::TeensyCore(config, millis());
  servo.attach(kServoPin, aerodima::kServo.least, aerodima::kServo.most);
  throttle.attach(kThrottlePin, aerodima::kThrottle.least, aerodima::kThrottle.most);
  WDT_timings_t timings;
  timings.timeout = kResetAfterS;
  processor_watchdog.begin(timings);
}

void loop() {
  const uint32_t now = millis();
  char bytes[256];
  int count = 0;
  while (count < static_cast<int>(sizeof bytes) && Serial.available()) bytes[count++] = static_cast<char>(Serial.read());
  core->feed(bytes, static_cast<size_t>(count), now);
  receive_frames();
  if (micros() - encoder_time >= kEncoderPeriodUs) {
    encoder_time = micros();
    core->set_sail_word(read_encoder());
  }
  core->step(now);
  send_frames();
  char text[aerodima::kLongestReply];
  const size_t size = core->take_reply(text, sizeof text);
  if (size && Serial.availableForWrite() >= static_cast<int>(size)) Serial.write(text, size);
  servo.writeMicroseconds(core->servo());
  throttle.writeMicroseconds(core->throttle());
  processor_watchdog.feed();
}
