/* What docs/quickstart.md has declared before its lines. */
#include <cophase.h>
extern const char scene[];
extern void must(cophase_status status);
extern const float data_e[128 * 128];
