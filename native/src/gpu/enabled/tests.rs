//! Kernels without a device; futures of a device against the processor's.
