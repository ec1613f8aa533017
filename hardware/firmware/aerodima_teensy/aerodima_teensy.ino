// The Teensy of the car: pins, serial port and CAN controller around the core in src/.
//
// `config.h` is written by `aerodima drive firmware`, from the parameters of the project.
// Libraries: FlexCAN_T4, Servo, WDT_T4 (all for Teensy 4); hardware/README.md has the versions it was checked against.

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

// The driver's queues stay empty: it would put frames of a dead bus there that nobody can take back, and its `write`
// says the same for "sent", "queued" and "lost, since the bus is off".
FlexCAN_T4<CAN1, RX_SIZE_2, TX_SIZE_2> can_bus;
constexpr FLEXCAN_MAILBOX kReservedMailbox = MB0, kSendMailbox = MB8;  // MB1 to MB7 receive
WDT_T4<WDT1> processor_watchdog;
Servo servo, throttle;
aerodima::TeensyCore* core;
uint32_t encoder_time, loop_time;

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

// Also the only safe way to take a frame back: a soft reset in freeze mode. An abort can put a frame with a wrong id on
// the bus (NXP ERR006032), and freeze mode alone a damaged one when the bus is off (ERR009595).
void start_can() {
  can_bus.begin();
  can_bus.setBaudRate(kCanBitrate);
  can_bus.setMB(kReservedMailbox, TX);
}

bool mailbox_is_free() {
  return FLEXCAN_get_code(FLEXCANb_MBn_CS(CAN1, kSendMailbox)) == FLEXCAN_MB_CODE_TX_INACTIVE;
}

// One mailbox, one frame at a time: nothing is overtaken, and an old order does not wait in the controller for a bus that
// comes back.
void send_frame() {
  static aerodima::CanFrame frame;
  if (!mailbox_is_free() && core->is_stale(frame)) start_can();
  if (!mailbox_is_free() || !core->next_frame(&frame)) return;
  CAN_message_t message;
  message.id = frame.id;
  message.len = frame.length;
  memcpy(message.buf, frame.data, sizeof frame.data);
  can_bus.write(kSendMailbox, message);
  for (int i = 0; i < 2; ++i) {  // or the frame may wait for ever on an idle bus (NXP ERR005829)
    FLEXCANb_MBn_CS(CAN1, kReservedMailbox) = FLEXCAN_MB_CS_CODE(FLEXCAN_MB_CODE_TX_INACTIVE);
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
  start_can();
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
  send_frame();
  char text[aerodima::kLongestReply];
  const size_t size = core->take_reply(text, sizeof text);
  if (size && Serial.availableForWrite() >= static_cast<int>(size)) Serial.write(text, size);
  servo.writeMicroseconds(core->servo());
  throttle.writeMicroseconds(core->throttle());
  if (now != loop_time) processor_watchdog.feed();  // with a clock that stands no watchdog of the core acts: start anew
  loop_time = now;
}
