/* What was destroyed and is used once more; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   freed SCENE.toml
 *
 * No caller may do this, and what watches memory says so. That it does not crash here is a guard and no promise. */
#include "setting.h"

int main(int argc, char **argv)
{
    struct setting s;
    cophase_sequence *sequence = NULL;
    cophase_device *device = NULL;
    cophase_input frames;
    size_t size;
    char text[64];
    char *scene;

    if (argc != 2)
        return 2;
    scene = read_file(argv[1], &size);
    s = setting_of(scene);
    free(scene);
    frames = frames_of(&s, 1);
    CHECK(cophase_sequence_create(s.model, 2, &sequence) == COPHASE_OK);
    CHECK(cophase_device_open("cpu", &device) == COPHASE_OK);

    cophase_sequence_destroy(sequence);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_sequence_clear(sequence));
    cophase_sequence_destroy(sequence);
    cophase_device_close(device);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_device_name(device, text, sizeof text, &size));
    cophase_device_close(device);
    cophase_session_destroy(s.session);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_session_load(s.session, &frames, NULL));
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_session_cancel(s.session));
    cophase_session_destroy(s.session);
    s.session = NULL;
    cophase_model_destroy(s.model);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_model_mode_count(s.model, &size));
    cophase_model_destroy(s.model);
    s.model = NULL;
    done_with(&s);
    return failures == 0 ? 0 : 1;
}
