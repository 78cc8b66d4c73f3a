/* What docs/c.md has declared before its lines. */
#include <cophase.h>
extern void must(cophase_status status);
extern cophase_estimator *estimator;
extern cophase_estimate *estimate;
extern cophase_input frames, slopes_mas;
extern double *pistons_nm;
