#!/usr/bin/env bash
# Build a program for a Cortex-M7 from an export: build.sh FOLDER MAIN.c KNEE.c ...; it becomes FOLDER/program.elf.
# On Debian: apt install gcc-arm-none-eabi libnewlib-arm-none-eabi
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
cd "$1" && shift
options=(-std=gnu11 -O2 -Wall -Wextra -mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard)
part() { arm-none-eabi-gcc "${options[@]}" --print-file-name="$1"; }
arm-none-eabi-gcc "${options[@]}" --specs=rdimon.specs -nostartfiles -Wl,--no-warn-rwx-segments -T "$here/memory.ld" -I . -o program.elf \
  "$@" "$here/startup.c" knee_contact.o "$(part rdimon-crt0.o)" "$(part crti.o)" "$(part crtn.o)" -lm
