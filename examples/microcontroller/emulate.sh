#!/usr/bin/env bash
# Run a program on an emulated Cortex-M7: emulate.sh PROGRAM.elf. An instruction takes 128 ns here, whatever it is.
# On Debian: apt install qemu-system-arm
exec timeout 100 qemu-system-arm -M mps2-an500 -nographic -monitor none -serial none \
  -semihosting-config enable=on,target=native -icount shift=7 -kernel "$1"
