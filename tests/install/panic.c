/* Whether a panic is caught inside the library that this is linked with: the tables by which it unwinds went through
 * every step of the installation. COPHASE_FAULT=panic makes the call fail from within, in a build with debug assertions. */
#include <cophase.h>
#include <stdio.h>

int main(void)
{
    cophase_estimator *estimator = NULL;
    cophase_estimate *estimate = NULL;
    const char *scene = NULL;
    cophase_status status = cophase_scene_preset("keck-artificial", &scene);

    if (status == COPHASE_OK)
        status = cophase_estimator_create(scene, NULL, NULL, &estimator);
    if (status == COPHASE_OK)
        status = cophase_estimator_estimate(estimator, NULL, 0, &estimate);
    cophase_estimator_destroy(estimator);
    printf("%s\n", cophase_status_name(status));
    return 0;
}
