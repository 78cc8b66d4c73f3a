/* cophase: phasing errors and non-common path aberrations of segmented telescopes.
 * Generated from src/capi by cbindgen; do not edit. */

#ifndef COPHASE_H
#define COPHASE_H

#include <stdint.h>

// Version of the C interface: it changes only when a program built against an older header could break.
#define COPHASE_ABI_VERSION 0

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Name of a status number: `OK`, `BAD_SCENE`, …; `UNKNOWN` for a number of a later version.
//
// Returns a static string that the caller must not free. Never NULL.
const char *cophase_status_name(int32_t status);

// Version of the library as text, such as "0.1.0".
//
// Returns a static string that the caller must not free. Never NULL.
const char *cophase_version(void);

// Version of the C interface of the library that is loaded; compare it with COPHASE_ABI_VERSION of the header.
uint32_t cophase_abi_version(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* COPHASE_H */
