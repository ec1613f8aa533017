"""The firmware compiled for the Teensy's processor and run by QEMU on an emulated Cortex-M7
(mps2-an500), or here.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

from aerodima.hardware.firmware.teensy_firmware import FirmwareSettings, export_sketch
from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8

HERE = Path(__file__).parent
PROGRAMS = HERE / "cortex_m7"
CPU = ("-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16")
COMMON = ("-std=gnu++17", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{HERE / 'teensy_api'}")
# As Teensyduino compiles, without its C++ library: the distribution's is a package of 1.5 GB.
TEENSY = (
    *CPU,
    *COMMON,
    "-nostdinc++",
    "-fno-exceptions",
    "-fno-rtti",
    "-fno-threadsafe-statics",
    "-ffunction-sections",
)
STRICT = ("-Wconversion", "-Wdouble-promotion")
TOOLS = ("arm-none-eabi-g++", "qemu-system-arm")
_LONGEST = 300.0  # s, for one run on a busy computer


def need_tools():
    """Skips the test where the cross compiler or the emulator is absent."""
    missing = [name for name in TOOLS if shutil.which(name) is None]
    if missing:
        pytest.skip(
            f"not on the path: {', '.join(missing)} (gcc-arm-none-eabi, libnewlib-arm-none-eabi, "
            "qemu-system-arm)"
        )


def run(*command, folder=None):
    """Standard output of a command that must succeed."""
    done = subprocess.run(
        list(map(str, command)), cwd=folder, capture_output=True, text=True, timeout=_LONGEST
    )
    assert done.returncode == 0, (
        f"{command[0]}: status {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-4000:]}"
    )
    return done.stdout


def export(folder):
    """The sketch of the wiring teensy_bridge, in the form in which the programs include it."""
    export_sketch(FirmwareSettings("teensy_bridge", AK70_10_V1_0_8), folder).rename(
        folder / "sketch.ino"
    )
    return folder


def on_host(program, sketch):
    """Output of a program of `cortex_m7/` and the exported core, on this computer."""
    sources = (PROGRAMS / f"{program}.cpp", *sorted((sketch / "src").glob("*.cpp")))
    run("g++", *COMMON, "-ffp-contract=off", f"-I{sketch}", *sources, "-o", sketch / program)
    return run(sketch / program)


def build(program, sketch):
    """A program of `cortex_m7/` and the exported core as an image for the emulator."""
    core = sketch / "src"
    objects = [sketch / f"{program}.start.o"]
    run(
        "arm-none-eabi-gcc",
        *CPU,
        *COMMON[1:],
        "-c",
        PROGRAMS / "start.c",
        "-o",
        objects[0],
    )
    for source in (PROGRAMS / f"{program}.cpp", PROGRAMS / "new.cpp", *sorted(core.glob("*.cpp"))):
        objects.append(sketch / f"{program}.{source.stem}.o")
        strict = STRICT if source.parent == core else ()
        run(
            "arm-none-eabi-g++",
            *TEENSY,
            *strict,
            f"-I{sketch}",
            f"-I{core}",
            "-c",
            source,
            "-o",
            objects[-1],
        )
    image = sketch / f"{program}.elf"
    link = (
        "-nostartfiles",
        "--specs=rdimon.specs",
        "-Wl,--gc-sections",
        f"-T{PROGRAMS / 'mps2.ld'}",
    )
    run("arm-none-eabi-gcc", *CPU, *link, *objects, "-lm", "-o", image)
    return image


def emulate(image, *words):
    """Output of an image in QEMU; its files are those of the image's folder."""
    machine = ("-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none")
    files = ("-semihosting-config", "enable=on,target=native")
    return run("qemu-system-arm", *machine, *files, *words, "-kernel", image, folder=image.parent)
