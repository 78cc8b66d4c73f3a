/* What docs/c-realtime.md has declared before its lines. */
#include <cophase.h>
extern const char scene[];
extern void must(cophase_status status);
extern cophase_model *model;
extern cophase_session *session;
extern cophase_session_options session_options;
extern cophase_fit_options fit_options;
extern double *coefficients_nm, *sigma_nm, *covariance_nm2;
extern size_t modes;
