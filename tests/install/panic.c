/* Whether a panic is caught inside the library that this is linked with: the tables by which it unwinds went through
 * every step of the installation. COPHASE_FAULT=panic makes the call fail from within, in a build with debug assertions. */
#include <cophase.h>
#include <stdio.h>

int main(void)
{
    cophase_device *device = NULL;
    char name[64];
    size_t length;
    cophase_status status = cophase_device_open("cpu", &device);

    if (status == COPHASE_OK)
        status = cophase_device_name(device, name, sizeof name, &length);
    cophase_device_close(device);
    printf("%s\n", cophase_status_name(status));
    return 0;
}
