// Which of the two modules this browser takes.

/** A function that returns a vector: browsers without SIMD do not accept it. */
const SIMD_PROBE = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11,
]);

/** `simd` where the browser has SIMD, else `scalar`: both give the same bits. */
export const MODULE = globalThis.WebAssembly?.validate(SIMD_PROBE) ? "simd" : "scalar";
