/* Which cophase is this? Built and run by tests/header.rs; by hand:
 *
 *   cargo build --release
 *   cc -std=c99 -Iinclude bindings/c/versions.c -Ltarget/release -lcophase -Wl,-rpath,$PWD/target/release -o versions
 */
#include <cophase.h>
#include <stdio.h>

int main(void)
{
    int32_t status;

    printf("cophase %s, C interface %u (this program: %u)\n", cophase_version(), (unsigned)cophase_abi_version(),
           (unsigned)COPHASE_ABI_VERSION);
    for (status = 0; status < 13; status++)
        printf("%d %s\n", (int)status, cophase_status_name(status));
    for (status = 100; status < 108; status++)
        printf("%d %s\n", (int)status, cophase_status_name(status));
    return cophase_abi_version() == COPHASE_ABI_VERSION ? 0 : 1;
}
