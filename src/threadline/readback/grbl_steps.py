"""The steps of a program, and their times, by grbl 1.1's own code, compiled for this computer.

``THREADLINE_GRBL`` names the folder ``grbl`` of a checkout of gnea/grbl. Its parser, planner and
stepper (``gcode.c``, ``motion_control.c``, ``planner.c``, ``stepper.c``, ``nuts_bolts.c``) are
compiled as they are, with a clock in place of the timer of its processor. grbl is GPL and no part
of Threadline: it is built and run in a separate folder.

Time advances from interrupt to interrupt, by ``OCR1A + 1`` cycles of 16 MHz each, as in the CTC
mode of the timer of an ATmega328P (data sheet, section 16.9.2).
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from threadline.errors import Place, RecordingError
from threadline.machine import Machine
from threadline.machine.motion_planner import GrblPlanner
from threadline.readback.stepped import Steps, compile_code

FOLDER = "THREADLINE_GRBL"
_AXES = "XYZ"
_PARTS = ("gcode", "motion_control", "planner", "stepper", "nuts_bolts")
_HEADS = ("avr/io.h", "avr/pgmspace.h", "avr/interrupt.h", "avr/wdt.h", "util/delay.h")
_FLAGS = ("-O1", "-w", "-fsingle-precision-constant", "-DF_CPU=16000000", "-include", "all.h")
_TIMEOUT_S = 600.0
_COMMENT = re.compile(r"\([^)\n]*\)|;[^\n]*")


def missing() -> str:
    """Return why grbl cannot be compiled here, and how to get it; empty if it can."""
    folder_name = os.environ.get(FOLDER)
    if not folder_name:
        return f"grbl's own code is missing: {FOLDER} names its folder grbl (docs/equal.md)"
    for part in _PARTS:
        if not (Path(folder_name) / f"{part}.c").is_file():
            return f"{FOLDER} is {folder_name[:120]}, which has no {part}.c (docs/equal.md)"
    if shutil.which("cc") is None:
        return "grbl's own code is not compiled: there is no C compiler cc"
    return ""


def unfit(machine: Machine, axes: Sequence[str]) -> str:  # noqa: ARG001
    """Return why grbl cannot run a job with these axes; empty if it can.

    grbl 1.1 has three axes, which its planner treats alike: a mandrel runs as one of them.
    """
    return "" if len(axes) <= len(_AXES) else f"grbl 1.1 has 3 axes, the job has {len(axes)}"


def steps_on_grbl(
    program: Path, machine: Machine, axes: Sequence[str], counts: Mapping[str, float]
) -> dict[str, Steps]:
    """Return the steps of every axis for a program that begins at position 0, from time 0 on.

    Parameters
    ----------
    counts
        Steps per mm or degree of each axis.

    Raises
    ------
    OptionError
        If grbl's code does not compile.
    RecordingError
        If grbl's code refuses a line of the program, or fails before its end.
    """
    planner = machine.planner
    assert isinstance(planner, GrblPlanner)
    source = Path(os.environ[FOLDER]).resolve()
    settings = [f"{1e3 * planner.junction_deviation.si:.9g}", f"{planner.look_ahead + 1}"]
    for axis in (*axes, *_AXES[len(axes) :]):
        axis_part = machine.axes[axis] if axis in axes and axis in counts else None
        if axis_part is None:
            settings += ["80", "1000", "100"]
            continue
        scale = 1e3 if axis_part.kind == "linear" else float(np.degrees(1.0))
        settings += [
            f"{counts[axis]:.9g}", f"{60.0 * scale * axis_part.velocity.si:.9g}",
            f"{scale * axis_part.acceleration.si:.9g}",
        ]  # fmt: skip
    text = program.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory(prefix="threadline-grbl-") as name:
        folder = Path(name)
        executable = _compiled(source, folder, planner.look_ahead + 1)
        process = subprocess.run(  # noqa: S603
            [str(executable)], input="\n".join([" ".join(settings), _renamed(text, axes), ""]),
            capture_output=True, text=True, errors="replace", timeout=_TIMEOUT_S, check=False,
        )  # fmt: skip
    *rows, last = process.stdout.splitlines() or [""]
    refusal = next((row for row in [*rows, last] if row.startswith("E")), None)
    if refusal is not None or last != "end" or process.returncode:
        line, code = (refusal or "E 0 0").split()[1:3]
        raise RecordingError(
            f"grbl's own code answers error:{code}" if refusal else "grbl's own code breaks off",
            place=Place(str(program), int(line)),
            remedy="Compile it again for grbl.",
        )
    step_rows = np.array([row.split() for row in rows], dtype=np.int64).reshape(-1, 4)
    return {
        axis: Steps(
            time_s=step_rows[step_rows[:, k + 1] != 0, 0] / 16e6,
            sense=step_rows[step_rows[:, k + 1] != 0, k + 1],
        )
        for k, axis in enumerate(axes)
        if (step_rows[:, k + 1] != 0).any()
    }


def _renamed(text: str, axes: Sequence[str]) -> str:
    """Return a program with the axes of grbl, line by line, without comments."""
    text = _COMMENT.sub("", text)
    if all(axis in _AXES for axis in axes):
        return text
    grbl_letter = dict(zip(axes, _AXES, strict=False))
    return re.sub(f"([{''.join(axes)}])(?=[-+.0-9])", lambda match: grbl_letter[match[1]], text)


def _compiled(source: Path, folder: Path, blocks: int) -> Path:
    (folder / "all.h").write_text(_AVR, encoding="ascii")
    for name in _HEADS:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text('#include "all.h"\n', encoding="ascii")
    (folder / "main.c").write_text(_MAIN, encoding="ascii")
    words = ["cc", *_FLAGS, f"-DBLOCK_BUFFER_SIZE={blocks}", f"-I{folder}", f"-I{source}"]
    words += ["main.c", *(str(source / f"{name}.c") for name in _PARTS), "-lm", "-static"]
    words += ["-Wl,--unresolved-symbols=ignore-all", "-o", "grbl"]
    remedy = f"{FOLDER} names the folder grbl of gnea/grbl 1.1 (docs/equal.md)."
    compile_code(words, "grbl's own code", remedy, folder)
    return folder / "grbl"


_AVR = """
#pragma once
#include <stdbool.h>
#include <stdint.h>
extern volatile uint8_t DDRB, DDRC, DDRD, PORTB, PORTC, PORTD, PINB, PINC, PIND;
extern volatile uint8_t TCCR0A, TCCR0B, TCCR1A, TCCR1B, TCCR2A, TCCR2B, TIMSK0, TIMSK1, TIMSK2;
extern volatile uint8_t TCNT0, OCR0A, OCR2A, TIFR0, PCICR, PCMSK0, PCMSK1, PCMSK2, SREG;
extern volatile uint16_t OCR1A, TCNT1;
enum { CS00, CS01, CS02, CS10 = 0, CS11, CS12, WGM10 = 0, WGM11, WGM12 = 3, WGM13,
       COM1B0 = 4, COM1B1, COM1A0, COM1A1, OCIE1A = 1, TOIE0 = 0, OCIE0A, OCIE0B,
       PCIE0 = 0, PCIE1, PCIE2 };
#define ISR(name) void name(void)
#define PSTR(s) (s)
#define PROGMEM
void waited(double s);
#define _delay_ms(x) waited((x) * 1e-3)
#define _delay_us(x) waited((x) * 1e-6)
#define sei()
#define cli()
"""
"""Replaces the processor: its registers are variables, its delays advance the clock."""
_MAIN = r"""
#include <stdio.h>
#include "grbl.h"
volatile uint8_t DDRB, DDRC, DDRD, PORTB, PORTC, PORTD, PINB, PINC, PIND;
volatile uint8_t TCCR0A, TCCR0B, TCCR1A, TCCR1B, TCCR2A, TCCR2B, TIMSK0, TIMSK1, TIMSK2;
volatile uint8_t TCNT0, OCR0A, OCR2A, TIFR0, PCICR, PCMSK0, PCMSK1, PCMSK2, SREG;
volatile uint16_t OCR1A, TCNT1;
system_t sys;
settings_t settings;
int32_t sys_position[N_AXIS], sys_probe_position[N_AXIS];
volatile uint8_t sys_probe_state, sys_rt_exec_state, sys_rt_exec_alarm;
volatile uint8_t sys_rt_exec_motion_override, sys_rt_exec_accessory_override;
static float coords[SETTING_INDEX_NCOORD + 1][N_AXIS];
static uint64_t cycles;
void TIMER1_COMPA_vect(void);
void TIMER0_OVF_vect(void);
void waited(double s) { cycles += (uint64_t)(s * 16e6 + 0.5); }
static void interrupt(void)
{
  int32_t before[N_AXIS];
  memcpy(before, sys_position, sizeof before);
  TIMER1_COMPA_vect();
  TIMER0_OVF_vect();
  int moved = 0;
  for (int i = 0; i < N_AXIS; i++) moved |= sys_position[i] != before[i];
  if (moved) {
    printf("%llu", (unsigned long long)cycles);
    for (int i = 0; i < N_AXIS; i++) printf(" %d", (int)(sys_position[i] - before[i]));
    printf("\n");
  }
  cycles += (uint64_t)OCR1A + 1;
}
static int under_way(void) { return TIMSK1 & (1 << OCIE1A); }
void protocol_auto_cycle_start(void)
{
  if (under_way() || !plan_get_current_block()) return;
  sys.state = STATE_CYCLE;
  st_prep_buffer();
  st_wake_up();
}
void protocol_execute_realtime(void)
{
  if (!under_way()) return;
  interrupt();
  if (under_way()) st_prep_buffer();
}
void protocol_buffer_synchronize(void)
{
  protocol_auto_cycle_start();
  while (under_way() || plan_get_current_block()) {
    protocol_execute_realtime();
    protocol_auto_cycle_start();
  }
}
void system_set_exec_state_flag(uint8_t flag)
{ if (flag & EXEC_CYCLE_STOP) sys.state = STATE_IDLE; }
uint8_t settings_read_coord_data(uint8_t i, float *d)
{ memcpy(d, coords[i], sizeof coords[i]); return 1; }
void settings_write_coord_data(uint8_t i, float *d) { memcpy(coords[i], d, sizeof coords[i]); }
uint8_t get_step_pin_mask(uint8_t i) { return 1 << (2 + i); }
uint8_t get_direction_pin_mask(uint8_t i) { return 1 << (5 + i); }
void system_flag_wco_change(void) {}
void spindle_sync(uint8_t state, float rpm) {}
void spindle_set_state(uint8_t state, float rpm) {}
void spindle_set_speed(uint8_t pwm) {}
uint8_t spindle_compute_pwm_value(float rpm) { return 0; }
void coolant_sync(uint8_t mode) {}
void coolant_set_state(uint8_t mode) {}
void report_feedback_message(uint8_t code) {}
void limits_soft_check(float *target) {}
void probe_state_monitor(void) {}
void system_convert_array_steps_to_mpos(float *p, int32_t *s)
{ for (int i = 0; i < N_AXIS; i++) p[i] = s[i] / settings.steps_per_mm[i]; }
int main(void)
{
  static char raw[8192], line[8192];
  int blocks = 0, number = 0;
  settings.pulse_microseconds = 10;
  settings.stepper_idle_lock_time = 255;
  settings.arc_tolerance = 0.002f;
  if (scanf("%f %d", &settings.junction_deviation, &blocks) != 2) return 2;
  for (int i = 0; i < N_AXIS; i++) {
    if (scanf("%f %f %f", settings.steps_per_mm + i, settings.max_rate + i,
              settings.acceleration + i) != 3) return 2;
    settings.acceleration[i] *= 60 * 60;
  }
  sys.f_override = sys.r_override = sys.spindle_speed_ovr = 100;
  sys.state = STATE_IDLE;
  stepper_init();
  gc_init();
  plan_reset();
  st_reset();
  plan_sync_position();
  gc_sync_position();
  if (!fgets(raw, sizeof raw, stdin)) return 2;
  while (fgets(raw, sizeof raw, stdin)) {
    number++;
    int n = 0;
    for (char *c = raw; *c && *c != '\n'; c++) {
      if ((unsigned char)*c <= ' ' || *c == '/' || *c == '%') continue;
      if (n >= LINE_BUFFER_SIZE - 1) { printf("E %d 11\n", number); return 0; }
      line[n++] = *c >= 'a' && *c <= 'z' ? *c - 32 : *c;
    }
    line[n] = 0;
    int status = n ? gc_execute_line(line) : 0;
    if (status) { printf("E %d %d\n", number, status); return 0; }
  }
  protocol_buffer_synchronize();
  printf("end\n");
  return 0;
}
"""
