/* What was destroyed and is used once more; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   freed SCENE.toml
 *
 * Handles of another type come first.
 *
 * No caller may do this, and what watches memory says so. That it does not crash here is a guard and no promise. */
#include "setting.h"

int main(int argc, char **argv)
{
    struct setting s;
    cophase_sequence *sequence = NULL;
    cophase_estimator *estimator = NULL;
    cophase_model_info info;
    cophase_input frames;
    size_t size;
    char *scene;

    if (argc != 2)
        return 2;
    scene = read_file(argv[1], &size);
    s = setting_of(scene);
    CHECK(cophase_estimator_create(scene, NULL, NULL, &estimator) == COPHASE_OK);
    free(scene);
    frames = frames_of(&s, 1);
    CHECK(cophase_sequence_create(s.model, 2, &sequence) == COPHASE_OK);

    /* A handle of another type. */
    REFUSED(COPHASE_BAD_ARGUMENT, "a handle of a sequence", cophase_session_cancel((cophase_session *)sequence));
    REFUSED(COPHASE_BAD_ARGUMENT, "a handle of a model", cophase_estimator_cancel((cophase_estimator *)s.model));
    REFUSED(COPHASE_BAD_ARGUMENT, "a handle of an estimator", cophase_model_get_info((cophase_model *)estimator, &info, sizeof info));
    REFUSED(COPHASE_BAD_ARGUMENT, "a handle of a session", cophase_sequence_push((cophase_sequence *)s.session, NULL));
    REFUSED(COPHASE_BAD_ARGUMENT, "a handle of a model", cophase_sequence_push(sequence, (cophase_session *)s.model));
    cophase_model_destroy((cophase_model *)s.session);
    cophase_estimate_destroy((cophase_estimate *)s.model);
    CHECK(cophase_model_get_info(s.model, &info, sizeof info) == COPHASE_OK);

    cophase_sequence_destroy(sequence);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_sequence_push(sequence, NULL));
    cophase_sequence_destroy(sequence);
    cophase_estimator_destroy(estimator);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_estimator_cancel(estimator));
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_estimator_progress(estimator, NULL, NULL, NULL));
    cophase_estimator_destroy(estimator);
    cophase_session_destroy(s.session);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_session_fit(s.session, &frames, 1, NULL, s.fitted_nm, NULL, s.modes, NULL, 0, NULL, 0));
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_session_cancel(s.session));
    cophase_session_destroy(s.session);
    s.session = NULL;
    cophase_model_destroy(s.model);
    REFUSED(COPHASE_BAD_ARGUMENT, "destroyed", cophase_model_get_info(s.model, &info, sizeof info));
    cophase_model_destroy(s.model);
    s.model = NULL;
    done_with(&s);
    return failures == 0 ? 0 : 1;
}
