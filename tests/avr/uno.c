// An Arduino Uno with firmware in simavr, its serial port as a pseudo-terminal, and the arm of the guide on its pins: steps
// move it, limit switches close at its ends, Z has the jumper of the guide (limit to direction). In real time.
//
// uno FIRMWARE.elf|FIRMWARE.hex [STEPS_PER_DEGREE]      USR1 presses reset, USR2 says where the arm really is.

#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <sim_hex.h>
#include <avr_ioport.h>
#include <avr_uart.h>
#include <uart_pty.h>

enum { HZ = 16000000, X_STEP = 2, Y_STEP = 3, X_DIR = 5, Y_DIR = 6, Z_DIR = 7, X_LIMIT = 1, Y_LIMIT = 2, Z_LIMIT = 4,
       OCR1AL = 0x88, TCCR2A = 0xb0, OCR2A = 0xb3 };

static avr_t *avr;
static uart_pty_t pty;
static uint8_t port_d;
static long at[2]; // steps from the switches, which are at 0
static int switched = -1; // the limit pins as they were set last
static volatile sig_atomic_t reset_wanted, report_wanted;

static void press(int n) { (void)n; reset_wanted = 1; }
static void ask(int n) { (void)n; report_wanted = 1; }

static void switches(void) {
  avr_ioport_external_t pins = { .name = 'B', .mask = 1 << X_LIMIT | 1 << Y_LIMIT | 1 << Z_LIMIT, .value = 0 };
  if (at[0] < 0) pins.value |= 1 << X_LIMIT;
  if (at[1] < 0) pins.value |= 1 << Y_LIMIT;
  if (port_d >> Z_DIR & 1) pins.value |= 1 << Z_LIMIT;
  if (switched == (int)pins.value) return;
  const int again = switched < 0;
  switched = pins.value;
  avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('B'), &pins);
  for (int bit = X_LIMIT; bit <= Z_LIMIT; bit++)
    if (pins.mask >> bit & 1) {
      const uint32_t value = pins.value >> bit & 1;
      // A value that simavr knows already is not passed on, and a reset has cleared the register.
      if (again) avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), bit), !value);
      avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), bit), value);
    }
}

static void pins_changed(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  const uint8_t rising = value & ~port_d;
  port_d = value;
  if (rising >> X_STEP & 1) at[0] += port_d >> X_DIR & 1 ? -1 : 1;
  if (rising >> Y_STEP & 1) at[1] += port_d >> Y_DIR & 1 ? -1 : 1;
  switches();
}

// Grbl's first step waits for a compare match at OCR1A = 0, which hardware has at once and simavr 1.6 never.
static void power_on(void) {
  avr_reset(avr);
  avr->data[OCR1AL] = 255;
  port_d = 0;
  switched = -1;
  switches();
}

static double seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char **argv) {
  if (argc < 2) return fprintf(stderr, "uno FIRMWARE [STEPS_PER_DEGREE]\n"), 2;
  const double steps = argc > 2 ? atof(argv[2]) : 88.889;
  avr = avr_make_mcu_by_name("atmega328p");
  if (!avr || avr_init(avr)) return fprintf(stderr, "simavr has no atmega328p\n"), 1;
  if (strstr(argv[1], ".hex")) {
    uint32_t size, base;
    uint8_t *code = read_ihex_file(argv[1], &size, &base);
    if (!code) return fprintf(stderr, "%s can't be read\n", argv[1]), 1;
    avr_loadcode(avr, code, size, base);
    avr->codeend = base + size - 1;
  } else {
    elf_firmware_t firmware = { 0 };
    if (elf_read_firmware(argv[1], &firmware)) return fprintf(stderr, "%s can't be read\n", argv[1]), 1;
    avr_load_firmware(avr, &firmware);
  }
  avr->frequency = HZ;
  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POOL_SLEEP);
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  uart_pty_init(avr, &pty);
  uart_pty_connect(&pty, '0');
  at[0] = -185 * steps;
  at[1] = -100 * steps;
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), IOPORT_IRQ_PIN_ALL), pins_changed, NULL);
  signal(SIGUSR1, press);
  signal(SIGUSR2, ask);
  printf("port %s\n", pty.pty.slavename);
  fflush(stdout);

  power_on();
  double start = seconds(), behind = 0;
  avr_cycle_count_t first = avr->cycle;
  for (;;) {
    const avr_cycle_count_t until = avr->cycle + HZ / 1000;
    while (avr->cycle < until) {
      const int state = avr_run(avr);
      if (state == cpu_Done || state == cpu_Crashed) return fprintf(stderr, "the firmware has crashed\n"), 1;
    }
    const double ahead = (double)(avr->cycle - first) / HZ - (seconds() - start);
    if (ahead > 0.001) {
      struct timespec rest = { 0, (long)(1e9 * ahead) };
      nanosleep(&rest, NULL);
    } else if (-ahead > 2 * behind + 0.5) {
      behind = -ahead;
      fprintf(stderr, "%.1f s behind real time: this machine is busy\n", behind);
    }
    if (reset_wanted) {
      reset_wanted = 0;
      power_on();
      start = seconds();
      first = avr->cycle;
    }
    if (report_wanted) {
      report_wanted = 0;
      printf("at %.3f %.3f led %d\n", at[0] / steps, at[1] / steps, avr->data[TCCR2A] >> 7 ? avr->data[OCR2A] : 0);
      fflush(stdout);
    }
  }
}
