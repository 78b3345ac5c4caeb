"""The parsers of grbl and Marlin, built from their own sources around a main program of the tests.

Both are GPL and no part of this project: an environment variable names a checkout, and the build
lies in a temporary folder. ``THREADLINE_GRBL`` is the folder ``grbl`` of a checkout of gnea/grbl,
whose ``gcode.c``, ``motion_control.c`` and ``nuts_bolts.c`` are compiled unchanged, with M7.
``THREADLINE_MARLIN`` is the folder ``Marlin`` of a checkout of MarlinFirmware/Marlin, whose
``parser.cpp`` is compiled; the effect of its commands is written here anew, from the files of each
command as their configuration files build them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

Point = tuple[float, float, float]


class Line(NamedTuple):
    """The moves of one line: their length, their end, and F in mm/min (0 for a rapid)."""

    length_mm: float
    end_mm: Point
    feed: float


class Reading(NamedTuple):
    """A control's reading of a program: moves by line, dwells in s, the first line it refused."""

    lines: dict[int, Line]
    dwells_s: list[float]
    refused: int


_NEW = "@new"


def grbl_folder() -> Path | None:
    """Return the folder ``grbl`` of a checkout, None without one."""
    named = os.environ.get("THREADLINE_GRBL")
    return Path(named) if named and shutil.which("gcc") else None


def marlin_folder() -> Path | None:
    """Return the folder ``Marlin`` of a checkout, None without one."""
    named = os.environ.get("THREADLINE_MARLIN")
    return Path(named) if named and shutil.which("g++") else None


def build_grbl(source: Path, folder: Path) -> Path:
    """Compile grbl's parser; return the program."""
    (folder / "all.h").write_text(_AVR)
    for name in ("avr/io.h", "avr/pgmspace.h", "avr/interrupt.h", "avr/wdt.h", "util/delay.h"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text('#include "all.h"\n')
    (folder / "main.c").write_text(_GRBL_MAIN)
    parts = [str(source / f"{name}.c") for name in ("gcode", "motion_control", "nuts_bolts")]
    subprocess.run(
        [
            "gcc", "-O1", "-w", "-fsingle-precision-constant", "-DENABLE_M7", "-DF_CPU=16000000",
            "-include", "all.h", f"-I{folder}", f"-I{source}", "main.c", *parts, "-lm", "-static",
            "-Wl,--unresolved-symbols=ignore-all", "-o", "grbl",
        ],
        cwd=folder, check=True,
    )  # fmt: skip
    return folder / "grbl"


def build_marlin(source: Path, folder: Path) -> Path:
    """Compile Marlin's parser; return the program."""
    for name in ("gcode/parser.cpp", "gcode/parser.h", "core/macros.h"):
        (folder / "src" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / "src" / name, folder / "src" / name)
    (folder / "src/inc").mkdir(exist_ok=True)
    (folder / "src/inc/MarlinConfig.h").write_text(_MARLIN_CONFIG)
    (folder / "src/MarlinCore.h").write_text("")
    (folder / "main.cpp").write_text(_MARLIN_MAIN)
    subprocess.run(
        ["g++", "-std=gnu++17", "-w", "-fpermissive", "-O1", "main.cpp", "src/gcode/parser.cpp",
         "-o", "marlin"],
        cwd=folder, check=True,
    )  # fmt: skip
    return folder / "marlin"


def klippy_folder() -> Path | None:
    """Return the folder ``klippy`` of the checkout that ``THREADLINE_KLIPPER`` names, or None."""
    named = os.environ.get("THREADLINE_KLIPPER")
    return Path(named) / "klippy" if named else None


def build_klipper(source: Path, folder: Path) -> Path:
    """Write a program that reads lines by Klipper's own modules; return the program."""
    program = folder / "klipper"
    program.write_text(f"#!{sys.executable}\nKLIPPY = {str(source)!r}\n{_KLIPPER_MAIN}")
    program.chmod(0o755)
    return program


def run(program: Path, programs: Sequence[Sequence[str]]) -> list[Reading]:
    """Return the readings of a control for each program, started anew for each."""
    text = "".join(f"{_NEW}\n" + "\n".join(lines) + "\n" for lines in programs)
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    answers = [_reading(part) for part in done.stdout.split(f"{_NEW}\n")[1:]]
    assert len(answers) == len(programs)
    return answers


def interpreted(
    rs274: str,
    program: Path,
    timeout_s: float = 60.0,
    settings: Path | None = None,
    more: tuple[str, ...] = (),
) -> str:
    """Return the answer of LinuxCNC's interpreter to a program: its calls, or its refusal.

    ``more`` are further words of its command line, such as a tool table. LinuxCNC shares the tools
    of an account in ``~/.tool.mmap``, so each run has its own home.
    """
    given = [] if settings is None else ["-i", str(settings)]
    with tempfile.TemporaryDirectory() as home:
        done = subprocess.run(
            [rs274, "-g", *given, *more, program.name], cwd=program.parent, capture_output=True,
            env=os.environ | {"HOME": home}, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
    assert done.returncode >= 0, f"rs274 dies of signal {-done.returncode}"
    return done.stdout + done.stderr


def _reading(text: str) -> Reading:
    lines: dict[int, Line] = {}
    dwells: list[float] = []
    refused = 0
    for row in text.splitlines():
        kind, at, *numbers = row.split()
        values = [float(number) for number in numbers]
        line = int(at)
        if kind == "L":
            before = lines[line].length_mm if line in lines else 0.0
            x, y, z, length, feed = values
            lines[line] = Line(before + length, (x, y, z), feed)
        elif kind == "D":
            dwells.append(values[0])
        elif kind == "E":
            refused = refused or line
    return Reading(lines, dwells, refused)


_KLIPPER_MAIN = r"""
# Lines go through gcode.py, gcode_move.py and gcode_arcs.py as they are. The tool head beneath them
# notes its moves; G4 and G28 are here as toolhead.py and homing.py have them, homed at zero.
import logging, math, sys
logging.disable(logging.CRITICAL)
sys.path[:0] = [KLIPPY, KLIPPY + "/extras"]
import gcode, gcode_arcs, gcode_move

class Printer:
    def __init__(self):
        self.events, self.objects, self.at, self.line = {}, {}, [0.0] * 4, 0
        self.command_error = self.config_error = gcode.CommandError
        self.objects["gcode"] = self.gcode = gcode.GCodeDispatch(self)
        self.objects["toolhead"] = self
        self.move_of = self.objects["gcode_move"] = gcode_move.GCodeMove(self)
        gcode_arcs.ArcSupport(self)
        self.gcode.register_command("G4", self.dwell)
        self.gcode.register_command("G28", self.home)
        self.send_event("klippy:ready")
        self.gcode.register_output_handler(self.told)
    def get_printer(self): return self
    def load_object(self, config, name): return self.objects[name]
    def lookup_object(self, name, default=None): return self.objects.get(name, default)
    def getfloat(self, name, default, above): return 0.05
    def get_start_args(self): return {}
    def get_reactor(self): return self
    def mutex(self): return None
    def register_event_handler(self, name, call): self.events.setdefault(name, []).append(call)
    def send_event(self, name, *given):
        for call in self.events.get(name, []): call(*given)
    def get_position(self): return list(self.at)
    def get_axes(self): return self.homed
    def move(self, new, speed):
        self.length += math.dist(new[:3], self.at[:3])
        self.at, self.speed = list(new), speed * 60.0
    def dwell(self, command):
        print("D", self.line, command.get_float("P", 0.0, minval=0.0) / 1000.0)
    def home(self, command):
        named = [k for k, axis in enumerate("XYZ") if command.get(axis, None) is not None]
        self.homed = named or [0, 1, 2]
        self.move([0.0 if k in self.homed else at for k, at in enumerate(self.at)], 0.0)
        self.send_event("homing:home_rails_end", self, [])
    def told(self, text):
        if text.startswith(("!!", "// Unknown")): print("E", self.line)

printer = None
for text in sys.stdin.read().splitlines():
    if text == "@new":
        print(text)
        printer = Printer()
    else:
        printer.line += 1
        printer.length = 0.0
        printer.gcode._process_commands([text])
        if printer.length:
            print("L", printer.line, *printer.at[:3], printer.length, printer.speed)
"""
_AVR = """
#include <stdbool.h>
#include <stdint.h>
#define PSTR(s) (s)
#define PROGMEM
#define _delay_ms(x) ((void)(x))
#define _delay_us(x) ((void)(x))
#define sei()
#define cli()
"""
_GRBL_MAIN = r"""
#include <stdio.h>
#include "grbl.h"
system_t sys;
settings_t settings;
int32_t sys_position[N_AXIS], sys_probe_position[N_AXIS];
volatile uint8_t sys_probe_state, sys_rt_exec_state, sys_rt_exec_alarm;
volatile uint8_t sys_rt_exec_motion_override, sys_rt_exec_accessory_override;
static float coords[SETTING_INDEX_NCOORD + 1][N_AXIS], at[N_AXIS];
static int number;
uint8_t settings_read_coord_data(uint8_t i, float *d)
{ memcpy(d, coords[i], sizeof coords[i]); return 1; }
void settings_write_coord_data(uint8_t i, float *d) { memcpy(coords[i], d, sizeof coords[i]); }
void protocol_buffer_synchronize(void) {}
void protocol_execute_realtime(void) {}
void protocol_auto_cycle_start(void) {}
void system_set_exec_state_flag(uint8_t flag) { (void)flag; }
void system_flag_wco_change(void) {}
void spindle_sync(uint8_t state, float rpm) { (void)state; (void)rpm; }
void spindle_set_state(uint8_t state, float rpm) { (void)state; (void)rpm; }
void coolant_sync(uint8_t mode) { (void)mode; }
void coolant_set_state(uint8_t mode) { (void)mode; }
void report_feedback_message(uint8_t code) { (void)code; }
void limits_soft_check(float *target) { (void)target; }
uint8_t plan_check_full_buffer(void) { return 0; }
void system_convert_array_steps_to_mpos(float *p, int32_t *s)
{ for (int i = 0; i < N_AXIS; i++) p[i] = s[i]; }
uint8_t plan_buffer_line(float *to, plan_line_data_t *data)
{
  float way = 0;
  for (int i = 0; i < N_AXIS; i++) { way += (to[i] - at[i]) * (to[i] - at[i]); at[i] = to[i]; }
  int rapid = data->condition & PL_COND_FLAG_RAPID_MOTION;
  printf("L %d %.6f %.6f %.6f %.6f %.6f\n", number, to[0], to[1], to[2], sqrtf(way),
         rapid ? 0.0 : data->feed_rate);
  return 1;
}
int main(void)
{
  static char raw[8192], line[8192];
  while (fgets(raw, sizeof raw, stdin)) {
    if (!strcmp(raw, "@new\n")) {
      memset(&sys, 0, sizeof sys);
      memset(coords, 0, sizeof coords);
      memset(at, 0, sizeof at);
      settings.arc_tolerance = 0.002f;
      gc_init();
      number = 0;
      printf("@new\n");
      continue;
    }
    number++;
    int n = 0, over = 0;
    char comment = 0;
    for (char *c = raw; *c && *c != '\n'; c++) {
      if (comment) { if (*c == ')' && comment == '(') comment = 0; }
      else if ((unsigned char)*c <= ' ' || *c == '/') continue;
      else if (*c == '(' || *c == ';') comment = *c;
      else if (n >= LINE_BUFFER_SIZE - 1) over = 1;
      else line[n++] = *c >= 'a' && *c <= 'z' ? *c - 32 : *c;
    }
    line[n] = 0;
    int status = over ? 11 : n ? gc_execute_line(line) : 0;
    if (status) printf("E %d %d\n", number, status);
  }
  return 0;
}
"""
_MARLIN_CONFIG = """
#pragma once
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
typedef uint32_t millis_t;
typedef float feedRate_t;
typedef const float const_float_t;
typedef int16_t celsius_t;
typedef int AxisEnum;
enum { E_AXIS = 9 };
#include "../core/macros.h"
#define FASTER_GCODE_PARSER 1
#define _BV32(b) (1UL << (b))
#undef TEST32
#define TEST32(n, b) (!!((n) & _BV32(b)))
#undef SBI32
#define SBI32(n, b) (n |= _BV32(b))
#define MMM_TO_MMS(v) ((v) / 60.0f)
#undef SEC_TO_MS
#define SEC_TO_MS(v) ((v) * 1000.0f)
#define SERIAL_ECHO_MSG(...)
#define SERIAL_EOL()
#define LOGICAL_AXIS_GANG(...)
#define STR_AXES_LOGICAL "XYZ"
#define constrain(v, lo, hi) ((v) < (lo) ? (lo) : (v) > (hi) ? (hi) : (v))
"""
_MARLIN_MAIN = r"""
#include "src/gcode/parser.h"
static float at[3], shift[3], feed, to[3];
static bool relative;
static int number;
static void moved(float length)
{
  for (int i = 0; i < 3; i++) at[i] = to[i];
  printf("L %d %.5f %.5f %.5f %.5f %.4f\n", number, at[0], at[1], at[2], length, feed * 60);
}
static void destination()
{
  for (int i = 0; i < 3; i++) {
    to[i] = at[i];
    if (!parser.seenval("XYZ"[i])) continue;
    const float value = parser.value_linear_units();
    to[i] = relative ? at[i] + value : value - shift[i];
  }
  if (parser.floatval('F') > 0) feed = parser.value_feedrate();
}
static void line()
{
  destination();
  float way = 0;
  for (int i = 0; i < 3; i++) way += (to[i] - at[i]) * (to[i] - at[i]);
  moved(sqrtf(way));
}
static void arc(bool clockwise)
{
  float away[2] = {0, 0};
  destination();
  if (parser.seenval('R')) {
    const float r = parser.value_linear_units();
    const float x = (to[0] - at[0]) / 2, y = (to[1] - at[1]) / 2, half = hypotf(x, y);
    if (r && half) {
      const float rise = sqrtf(fmaxf(0, (r - half) * (r + half))) * (clockwise ^ (r < 0) ? -1 : 1);
      away[0] = x - y / half * rise;
      away[1] = y + x / half * rise;
    }
  }
  else {
    if (parser.seenval('I')) away[0] = parser.value_linear_units();
    if (parser.seenval('J')) away[1] = parser.value_linear_units();
  }
  if (!away[0] && !away[1]) return;
  const float x = to[0] - at[0] - away[0], y = to[1] - at[1] - away[1];
  float turn = float(2 * M_PI);
  if (fabsf(at[0] - to[0]) >= 1e-6f || fabsf(at[1] - to[1]) >= 1e-6f) {
    turn = atan2f(away[1] * x - away[0] * y, -away[0] * x - away[1] * y);
    if (!turn) return;
    if (clockwise) turn = -turn;
    if (turn < 0) turn += float(2 * M_PI);
  }
  moved(hypotf(hypotf(away[0], away[1]) * turn, to[2] - at[2]));
}
static void home()
{
  const bool some = parser.seen('X') || parser.seen('Y') || parser.seen('Z');
  for (int i = 0; i < 3; i++) {
    to[i] = at[i];
    if (!some || parser.seen("XYZ"[i])) to[i] = shift[i] = 0;
  }
  float way = 0;
  for (int i = 0; i < 3; i++) way += (to[i] - at[i]) * (to[i] - at[i]);
  const float kept = feed;
  feed = 0;
  moved(sqrtf(way));
  feed = kept;
}
static void dwell()
{
  millis_t ms = 0;
  if (parser.seenval('P')) ms = parser.value_millis();
  if (parser.seenval('S')) ms = parser.value_millis_from_seconds();
  printf("D %d %.3f\n", number, ms / 1000.0);
}
int main()
{
  static char raw[8192], code[96];
  long last = 0;
  while (fgets(raw, sizeof raw, stdin)) {
    if (!strcmp(raw, "@new\n")) {
      memset(at, 0, sizeof at);
      memset(shift, 0, sizeof shift);
      feed = 25;
      relative = false;
      number = last = 0;
      printf("@new\n");
      continue;
    }
    number++;
    int n = 0;
    for (char *c = raw; *c && *c != '\n' && *c != ';' && n < 95; c++) code[n++] = *c;
    code[n] = 0;
    char *command = code;
    while (*command == ' ') command++;
    if (*command == 'N') {
      const bool sets = strstr(command, "M110");
      char *second = sets ? strchr(command + 4, 'N') : nullptr;
      const long given = strtol((second ? second : command) + 1, nullptr, 10);
      char *star = strrchr(command, '*');
      uint8_t sum = 0;
      for (char *c = command; star && c < star; c++) sum ^= *c;
      if ((given != last + 1 && !sets) || !star || strtol(star + 1, nullptr, 10) != sum) continue;
      last = given;
    }
    parser.parse(code);
    if (parser.command_letter != 'G') continue;
    switch (parser.codenum) {
      case 0: case 1: line(); break;
      case 2: case 3: arc(parser.codenum == 2); break;
      case 4: dwell(); break;
      case 28: home(); break;
      case 90: relative = false; break;
      case 91: relative = true; break;
      case 92:
        for (int i = 0; i < 3; i++)
          if (parser.seenval("XYZ"[i])) shift[i] = parser.value_linear_units() - at[i];
    }
  }
}
"""
