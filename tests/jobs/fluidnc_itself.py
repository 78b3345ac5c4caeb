"""FluidNC's parser, built from its own sources around a main program and headers of the tests.

It is GPL and no part of this project: ``THREADLINE_FLUIDNC`` names the folder ``FluidNC/src`` of a
checkout of bdring/FluidNC, whose ``GCode.cpp``, ``Expression.cpp``, ``Parameters.cpp``,
``Flowcontrol.cpp``, ``Job.cpp`` and ``MotionControl.cpp`` are compiled unchanged, in a temporary
folder. A program is run as a job from a file: the first error ends it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

_SOURCES = ("GCode", "Expression", "Parameters", "Flowcontrol", "Job", "MotionControl")
_HEADERS = ("GCode", "Expression", "Parameters", "Flowcontrol", "Job", "MotionControl", "Error",
            "SpindleDatatypes", "Types", "Planner", "NutsBolts", "Config")  # fmt: skip
_OURS = (
    "Settings", "Report", "Jog", "Protocol", "Machine/UserOutputs", "Machine/UserInputs",
    "Platform", "Machine/MachineConfig", "Machine/Homing", "Limit", "State", "Probe", "System",
    "Configuration/GCodeParam", "Channel", "Logging", "Assertion", "Driver/delay_usecs",
)  # fmt: skip


def fluidnc_folder() -> Path | None:
    """Return the folder ``FluidNC/src`` of a checkout, None without one."""
    named = os.environ.get("THREADLINE_FLUIDNC")
    return Path(named) if named and shutil.which("g++") else None


def build_fluidnc(source: Path, folder: Path) -> Path:
    """Compile FluidNC's parser; return the program."""
    for name in _SOURCES:
        shutil.copy(source / f"{name}.cpp", folder / f"{name}.cpp")
    for name in _HEADERS:
        shutil.copy(source / f"{name}.h", folder / f"{name}.h")
    for name in _OURS:
        (folder / f"{name}.h").parent.mkdir(exist_ok=True)
        (folder / f"{name}.h").write_text('#pragma once\n#include "all.h"\n')
    (folder / "all.h").write_text(_ALL)
    (folder / "main.cpp").write_text(_MAIN)
    subprocess.run(
        ["g++", "-std=gnu++17", "-w", "-fpermissive", "-O1", "-I.", "-include", "all.h", "main.cpp",
         *(f"{name}.cpp" for name in _SOURCES), "-o", "fluidnc"],
        cwd=folder, check=True,
    )  # fmt: skip
    return folder / "fluidnc"


_ALL = r"""
#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <string_view>
#include <vector>
#include "Types.h"
#include "Error.h"
#define log_info(x)
#define log_debug(x)
#define log_error(x)
#define log_warn(x)
#define log_info_to(o, x)
#define log_string(o, x)
enum class DwellMode : uint8_t;
enum CoordIndex : uint16_t;
enum class Override : uint8_t;
enum class State { Idle, Alarm, CheckMode, Hold };
enum class ExecAlarm { ProbeFailInitial, ProbeFailContact };
enum class Message { ProgramEnd };
enum class SpindleState : uint8_t;
struct gc_modal_t;
struct plan_line_data_t;
struct parser_block_t;
struct CoolantState;
class Channel {
  public:
    size_t at = 0, number = 0;
    bool percented = false, ended = false;
    void save() {}
    void restore() {}
    size_t position() { return at; }
    void set_position(size_t to) { at = to; }
    size_t lineNumber() { return number; }
    void setLineNumber(size_t to) { number = to; }
    void percent() { percented = true; }
    void end() { ended = true; }
};
struct All : Channel { void notifyNgc(CoordIndex) {} void notifyOvr() {} void notifyWco() {} };
extern All allChannels;
struct Pin {
    const char *legend() { return ""; }
    bool undefined() { return true; }
    int get() { return 0; }
};
namespace Configuration {
struct GCodeParam { bool isHandled_ = false; GCodeParam(const char *, float &, bool) {} };
}
struct Config {
    bool _enableParkingOverrideControl = false, _useLineNumbers = false;
    float _arcTolerance = 0.002f;
    struct Coolant { bool hasFlood() { return true; } bool hasMist() { return true; } void off() {}
                     void set_state(CoolantState) ; } *_coolant = new Coolant;
    struct Start { bool _deactivateParking = false; } *_start = new Start;
    struct Probe { bool _check_mode_start = false; bool exists() { return false; }
                   bool tripped() { return false; } void set_direction(bool) {} };
    Probe *_probe = new Probe;
    struct Inputs { Pin digitalInput[8], analogInput[4]; } *_userInputs = new Inputs;
    struct Outputs { bool setDigital(int, bool) { return true; }
                     bool setAnalogPercent(int, float) { return true; } };
    Outputs *_userOutputs = new Outputs;
    struct Kinematics { bool cartesian_to_motors(float *, plan_line_data_t *, float *);
                        bool invalid_line(float *) { return false; }
                        template <class... T> bool invalid_arc(T...) { return false; }
    } *_kinematics = new Kinematics;
    void group(Configuration::GCodeParam &) {}
};
extern Config *config;
struct Axes { static constexpr axis_t _numberAxis = A_AXIS; };
struct Spindle {
    bool is_reversable = true;
    std::string _atc_name;
    struct { std::string get() { return ""; } } _m6_macro;
    bool isRateAdjusted() { return false; }
    void setState(SpindleState, uint32_t) {}
    void spinDown() {}
    void tool_change(uint32_t, bool, bool) {}
};
extern Spindle *spindle;
namespace Spindles {
struct SpindleFactory { static int objects() { return 0; } };
struct Spindle { template <class... T> static void switchSpindle(T...) {} };
}
struct Sys {
    bool abort() { return false; }
    void set_f_override(int) {}
    void set_r_override(int) {}
    void set_spindle_speed_ovr(int) {}
    int f_override() { return 100; }
    int spindle_speed_ovr() { return 100; }
    void set_override_ctrl(Override) {}
    struct { bool executeHold = false, executeSysMotion = false; } step_control;
};
extern Sys sys;
struct Stepper { static void reset() {} };
struct Stepping { static void beginLowLatency() {} static void endLowLatency() {} };
class Coordinates {
    float kept[MAX_N_AXIS] = {};
  public:
    void get(float *to) { memcpy(to, kept, sizeof kept); }
    const float *get() { return kept; }
    float get(axis_t axis) { return kept[axis]; }
    void set(axis_t axis, float value) { kept[axis] = value; }
    void set(float *from) { memcpy(kept, from, sizeof kept); }
};
extern Coordinates *coords[];
extern int report_ovr_counter, report_wco_counter;
extern int32_t probe_steps[];
extern void *feedHoldEvent, *cycleStartEvent;
const char *const grbl_version = "4.0";
const int JOG_LINE_NUMBER = 0;
inline bool state_is(State which) { return which == State::Idle; }
inline bool inMotionState() { return false; }
inline void protocol_buffer_synchronize() {}
inline void protocol_execute_realtime() {}
inline void protocol_auto_cycle_start() {}
template <class... T> void protocol_send_event(T...) {}
inline void report_feedback_message(Message) {}
template <class T> void report_probe_parameters(T &) {}
inline void send_alarm(ExecAlarm) {}
inline const char *errorString(Error) { return ""; }
float *get_mpos();
float *get_wco();
inline int32_t *get_steps() { static int32_t none[MAX_N_AXIS]; return none; }
inline void get_steps(int32_t *) {}
inline void steps_to_mpos(float *to, int32_t *) { memset(to, 0, MAX_N_AXIS * sizeof *to); }
inline void mpos_to_wpos(float *) {}
template <class... T> Error jog_execute(T...) { return Error::Ok; }
template <class T> void copyAxes(T *to, const T *from)
{ memcpy(to, from, MAX_N_AXIS * sizeof *to); }
"""
_MAIN = r"""
#include <cstdio>
#include <sys/wait.h>
#include <unistd.h>
#include "GCode.h"
#include "Job.h"
#include "MotionControl.h"
#include "Parameters.h"
All allChannels;
Config *config = new Config;
Spindle *spindle = new Spindle;
Sys sys;
Coordinates *coords[CoordIndex::End];
int report_ovr_counter, report_wco_counter;
int32_t probe_steps[MAX_N_AXIS];
void *feedHoldEvent, *cycleStartEvent;
static float at[MAX_N_AXIS];
static size_t number;
float *get_mpos() { static float to[MAX_N_AXIS]; copyAxes(to, at); return to; }
float *get_wco()
{
    static float to[MAX_N_AXIS];
    for (int i = 0; i < MAX_N_AXIS; i++)
        to[i] = gc_state.coord_system[i] + gc_state.coord_offset[i];
    return to;
}
void Config::Coolant::set_state(CoolantState) {}
bool Config::Kinematics::cartesian_to_motors(float *to, plan_line_data_t *data, float *)
{ return mc_move_motors(to, data); }
float hypot_f(float x, float y) { return sqrtf(x * x + y * y); }
bool multiple_bits_set(uint32_t value) { return value & (value - 1); }
bool dwell_ms(uint32_t ms, DwellMode)
{ printf("D %zu %.3f\n", number, ms / 1000.0); return true; }
void plan_reset() {}
void plan_sync_position() {}
uint8_t plan_check_full_buffer() { return 0; }
bool plan_buffer_line(float *to, plan_line_data_t *data)
{
    float way = 0;
    for (int i = 0; i < 3; i++) way += (to[i] - at[i]) * (to[i] - at[i]);
    copyAxes(at, to);
    printf("L %zu %.6f %.6f %.6f %.6f %.6f\n", number, to[0], to[1], to[2], sqrtf(way),
           data->motion.rapidMotion ? 0.0 : data->feed_rate);
    return true;
}
static Error run(const char *line)
{
    if (!*line) return Error::Ok;
    while (isspace(*line)) ++line;
    if (*line == '$' || *line == '[') return Error::InvalidStatement;
    return gc_execute_line(line);
}
static void job(const std::vector<std::string> &lines)
{
    fflush(stdout);
    const pid_t child = fork();  // each from the start, and one that crashes it ends alone
    int ended;
    if (child) {
        waitpid(child, &ended, 0);
        if (ended) printf("@new\nE 1 255\n");
        return;
    }
    for (int i = 0; i < CoordIndex::End; i++) coords[i] = new Coordinates;
    memset(at, 0, sizeof at);
    gc_init();
    Channel *file = new Channel;
    Job::nest(file, nullptr);
    printf("@new\n");
    size_t blank = 0, steps = 0;
    while (file->at < lines.size() && !file->ended) {
        const std::string &line = lines[file->at];
        number = ++file->at;
        blank += line.empty();
        Error status = line.size() > 255 ? Error::LineLengthExceeded : run(line.c_str());
        if (file->percented) {
            file->percented = false;
            if (number != blank + 1) file->ended = true;
        }
        if (status != Error::Ok || ++steps > 20000) {
            printf("E %zu %d\n", number, int(status));
            break;
        }
    }
    fflush(stdout);
    _exit(0);
}
int main()
{
    static char raw[8192];
    std::vector<std::string> lines;
    bool some = false;
    while (fgets(raw, sizeof raw, stdin)) {
        raw[strcspn(raw, "\n")] = 0;
        if (strcmp(raw, "@new")) { lines.push_back(raw); continue; }
        if (some) job(lines);
        lines.clear();
        some = true;
    }
    job(lines);
}
"""
