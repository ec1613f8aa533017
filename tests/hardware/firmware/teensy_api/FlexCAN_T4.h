// What the sketch uses of tonton81/FlexCAN_T4 (b928bcb, May 2023), with a model of its controller behind it.
//
// The model has what decides about order and age: 16 mailboxes of which MB0 to MB7 receive, one frame at a time on the bus,
// no acknowledgement, bus-off with its recovery, the driver's queue for transmission, and a `write` whose answer is a bool.
#pragma once
#include "Arduino.h"

typedef struct CAN_message_t {
  uint32_t id = 0;
  struct {
    bool extended = 0, remote = 0, overrun = 0, reserved = 0;
  } flags;
  uint8_t len = 8;
  uint8_t buf[8] = {0};
  int8_t mb = 0;
  bool seq = 0;
} CAN_message_t;

typedef enum FLEXCAN_MAILBOX { MB0 = 0, MB1, MB2, MB3, MB4, MB5, MB6, MB7, MB8, MB15 = 15 } FLEXCAN_MAILBOX;
typedef enum FLEXCAN_RXTX { TX, RX, LISTEN_ONLY } FLEXCAN_RXTX;
typedef enum FLEXCAN_IDE { NONE = 0, EXT = 1, RTR = 2, STD = 3, INACTIVE } FLEXCAN_IDE;
typedef enum FLEXCAN_RXQUEUE_TABLE { RX_SIZE_2 = 2, RX_SIZE_256 = 256 } FLEXCAN_RXQUEUE_TABLE;
typedef enum FLEXCAN_TXQUEUE_TABLE { TX_SIZE_2 = 2, TX_SIZE_64 = 64 } FLEXCAN_TXQUEUE_TABLE;
typedef enum CAN_DEV_TABLE { CAN1 = (uint32_t)0x401D0000 } CAN_DEV_TABLE;

#define FLEXCAN_MB_CS_CODE(x) (((x) & 0x0000000F) << 24)
#define FLEXCAN_MB_CODE_TX_INACTIVE (8)
#define FLEXCAN_MB_CODE_TX_ONCE (0x0C)
#define FLEXCAN_get_code(cs) (((cs) & 0x0F000000UL) >> 24)
#define FLEXCANb_MBn_CS(b, n) (can_model.mailboxes[n].status)

struct CanModel {
  struct Mailbox {
    uint32_t status = 0;
    CAN_message_t message;
  };
  static constexpr int kMailboxes = 16, kFirstToSend = 8;
  static constexpr uint32_t kQueue = 64, kStepUs = 20, kFrameUs = 140, kRecoveryUs = 1400;  // of 8 bytes, of 128 times 11 bits

  Mailbox mailboxes[kMailboxes];
  CAN_message_t queue[kQueue], received[kQueue];
  uint32_t queued = 0, waiting = 0, queue_size = kQueue;
  bool acknowledged = true, shorted = false, busy_with_others = false;
  int errors = 0, sending = -1;
  uint32_t remaining = 0;  // us, of the frame on the bus or of the recovery
  int restarts = 0;

  bool bus_off() const { return errors >= 256; }
  bool free(int mailbox) const { return FLEXCAN_get_code(mailboxes[mailbox].status) == FLEXCAN_MB_CODE_TX_INACTIVE; }

  void restart() {  // freeze mode ends with the frame on the bus, the soft reset clears mailboxes and error counters
    for (Mailbox& mailbox : mailboxes) mailbox = Mailbox();
    for (int i = kFirstToSend; i < kMailboxes; ++i) mailboxes[i].status = FLEXCAN_MB_CS_CODE(FLEXCAN_MB_CODE_TX_INACTIVE);
    errors = 0;
    sending = -1;
    remaining = kFrameUs;
    ++restarts;
  }

  void put(int mailbox, const CAN_message_t& message) {
    mailboxes[mailbox].message = message;
    mailboxes[mailbox].status = FLEXCAN_MB_CS_CODE(FLEXCAN_MB_CODE_TX_ONCE);
  }

  bool enqueue(CAN_message_t message, int mailbox) {  // true for a bus that is off, false for a queue that is full
    if (bus_off()) return true;
    if (queued == queue_size) return false;
    message.mb = static_cast<int8_t>(mailbox);
    queue[queued++] = message;
    return true;
  }

  void drain(int mailbox) {  // the interrupt that follows a transmission
    if (!queued || (queue[0].mb != -1 && queue[0].mb != mailbox)) return;
    put(mailbox, queue[0]);
    memmove(queue, queue + 1, --queued * sizeof *queue);
  }

  // One step of the bus; true when `sent` has left.
  bool advance(CAN_message_t* sent) {
    if (remaining && (remaining -= kStepUs)) return false;
    if (bus_off()) {
      if (sending != kMailboxes) {
        sending = kMailboxes;
        remaining = kRecoveryUs;
      } else {
        errors = 0;
        sending = -1;
      }
      return false;
    }
    if (sending >= 0) {
      const int mailbox = sending;
      sending = -1;
      if (shorted) {
        errors += 8;
      } else if (!acknowledged) {
        if (errors < 128) errors += 8;  // error passive; without an acknowledgement no further
      } else {
        if (errors) --errors;
        *sent = mailboxes[mailbox].message;
        mailboxes[mailbox].status = FLEXCAN_MB_CS_CODE(FLEXCAN_MB_CODE_TX_INACTIVE);
        drain(mailbox);
        return true;
      }
    }
    if (busy_with_others) return false;
    for (int i = 0; i < kMailboxes; ++i) {
      if (FLEXCAN_get_code(mailboxes[i].status) != FLEXCAN_MB_CODE_TX_ONCE) continue;
      if (sending < 0 || mailboxes[i].message.id < mailboxes[sending].message.id) sending = i;
    }
    if (sending >= 0) remaining = kFrameUs;
    return false;
  }
};
extern CanModel can_model;

template <CAN_DEV_TABLE _bus, FLEXCAN_RXQUEUE_TABLE _rxSize, FLEXCAN_TXQUEUE_TABLE _txSize>
class FlexCAN_T4 {
 public:
  void begin() {
    can_model.restart();
    can_model.queue_size = _txSize;
  }
  void setBaudRate(uint32_t, FLEXCAN_RXTX = TX) {}
  bool setMB(const FLEXCAN_MAILBOX& mb_num, const FLEXCAN_RXTX& mb_rx_tx, const FLEXCAN_IDE& = STD) {
    can_model.mailboxes[mb_num].status = mb_rx_tx == TX ? FLEXCAN_MB_CS_CODE(FLEXCAN_MB_CODE_TX_INACTIVE) : 0;
    return true;
  }
  int read(CAN_message_t& msg) {
    if (!can_model.waiting) return 0;
    msg = can_model.received[0];
    memmove(can_model.received, can_model.received + 1, --can_model.waiting * sizeof msg);
    return 1;
  }
  int write(const CAN_message_t& msg) {
    const int first = CanModel::kFirstToSend;
    for (int i = first; i < (msg.seq ? first + 1 : CanModel::kMailboxes); ++i) {
      if (can_model.free(i)) return write(static_cast<FLEXCAN_MAILBOX>(i), msg);
    }
    return can_model.enqueue(msg, msg.seq ? first : -1);
  }
  int write(FLEXCAN_MAILBOX mb_num, const CAN_message_t& msg) {
    if (!can_model.free(mb_num)) return can_model.enqueue(msg, mb_num);
    can_model.put(mb_num, msg);
    return 1;
  }
};
