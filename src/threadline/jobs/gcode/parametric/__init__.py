"""Part programs with parameters, expressions and O words, as LinuxCNC and FluidNC read them."""
