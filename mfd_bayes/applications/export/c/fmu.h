/* What the FMUs of FMI 2.0 and 3.0 have in common: an instance, its variables and its step.
 *
 * The displacement, velocity and actuation that are set are those at the end of the next step (and,
 * before the first, those at the start time). The functions of the standard are declared here and
 * in fmi2.c and fmi3.c, by its text, so that no header from elsewhere is needed.
 */
#ifndef DAMPER_FMU_H
#define DAMPER_FMU_H

#include "damper.h"
#include "fmu_model.h" /* FMU_TOKEN, FMU_ACTUATION: of the device that was exported */

#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define FMU_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMU_EXPORT __attribute__((visibility("default")))
#else
#define FMU_EXPORT
#endif

#define FMU_PASTE(a, b) a##b
#define FMU_NAME(a, b) FMU_PASTE(a, b)

/* Value references, as modelDescription.xml has them. */
enum { DISPLACEMENT, VELOCITY, ACTUATION, FORCE, ENERGY, GAP_TRAVEL, OFFSET, SET, DIRECTION, TIME };

typedef struct {
    damper_state state;
    double input[3], offset, time; /* displacement, velocity, actuation */
    int direction, set, begun;
} fmu_memory;

typedef void (*fmu_logger)(void *instance, int status, const char *message);

typedef struct {
    damper device;
    fmu_memory now;
    void *environment, *callback; /* of the importer */
    char *name;
    fmu_logger log;
} fmu_instance;

enum { FMU_OK, FMU_WARNING, FMU_DISCARD, FMU_ERROR };

static int fmu_fails(fmu_instance *fmu, const char *message) {
    fmu->log(fmu, FMU_ERROR, message);
    return FMU_ERROR;
}

static void fmu_reset(fmu_instance *fmu) {
    memset(&fmu->now, 0, sizeof fmu->now);
    fmu->now.input[2] = FMU_ACTUATION;
}

static fmu_instance *fmu_new(const char *name, const char *token, fmu_logger log) {
    fmu_instance *fmu = NULL;
    if (token && strcmp(token, FMU_TOKEN) == 0) fmu = calloc(1, sizeof *fmu);
    if (!fmu) return NULL;
    fmu->name = malloc(strlen(name ? name : "") + 1);
    if (!fmu->name) {
        free(fmu);
        return NULL;
    }
    strcpy(fmu->name, name ? name : "");
    fmu->log = log;
    fmu_reset(fmu);
    return fmu;
}

static void fmu_free(fmu_instance *fmu) {
    if (fmu) free(fmu->name);
    free(fmu);
}

static int fmu_status(fmu_instance *fmu, int code) {
    switch (code) {
    case DAMPER_OK: return FMU_OK;
    case DAMPER_UNTESTED:
        fmu->log(fmu, FMU_WARNING, "the actuation lies outside of the tested range");
        return FMU_WARNING;
    case DAMPER_BAD_SET: return fmu_fails(fmu, "the set's parameters cannot be");
    case DAMPER_BAD_STEP:
        return fmu_fails(fmu, "a step must be positive, displacement and velocity finite");
    case DAMPER_BAD_ACTUATION:
        return fmu_fails(fmu, "the actuation lies outside of the range of the laws");
    default: return fmu_fails(fmu, "the force is no finite number at this step");
    }
}

/* The first sample, with the inputs as they are set. */
static int fmu_begin(fmu_instance *fmu) {
    const double *in = fmu->now.input;
    int code = damper_prepare(&fmu->device, &damper_sets[fmu->now.set]);
    if (code == DAMPER_OK) code = damper_start(&fmu->now.state, &fmu->device, fmu->now.direction);
    if (code == DAMPER_OK) code = damper_step(&fmu->now.state, 0.0, in[0], in[1], in[2]);
    return fmu_status(fmu, code);
}

static int fmu_step(fmu_instance *fmu, double time, double size) {
    const double *in = fmu->now.input;
    int status = fmu_status(fmu, damper_step(&fmu->now.state, size, in[0], in[1], in[2]));
    if (status <= FMU_WARNING) fmu->now.time = time + size;
    return status;
}

static int fmu_get_real(fmu_instance *fmu, const unsigned *reference, size_t n, double *value) {
    size_t i;
    int status = fmu->now.begun ? FMU_OK : -1; /* outputs at the start follow the inputs */
    for (i = 0; i < n; i++) {
        const fmu_memory *now = &fmu->now;
        unsigned r = reference[i];
        if (r >= FORCE && r <= GAP_TRAVEL && status < 0) {
            status = fmu_begin(fmu);
            if (status >= FMU_ERROR) return status;
        }
        switch (r) {
        case DISPLACEMENT:
        case VELOCITY:
        case ACTUATION: value[i] = now->input[r]; break;
        case FORCE: value[i] = now->state.force + now->offset; break;
        case ENERGY: value[i] = now->state.work; break;
        case GAP_TRAVEL: value[i] = now->state.gap_travel; break;
        case OFFSET: value[i] = now->offset; break;
        case TIME: value[i] = now->time; break;
        default: return fmu_fails(fmu, "there is no real number of this value reference");
        }
    }
    return status < 0 ? FMU_OK : status;
}

static int fmu_set_real(fmu_instance *fmu, const unsigned *reference, size_t n,
                        const double *value) {
    size_t i;
    for (i = 0; i < n; i++) {
        unsigned r = reference[i];
        if (r <= ACTUATION) fmu->now.input[r] = value[i];
        else if (r == OFFSET && !fmu->now.begun) fmu->now.offset = value[i];
        else return fmu_fails(fmu, "this real number cannot be set (offset: before the start)");
    }
    return FMU_OK;
}

static int fmu_get_integer(fmu_instance *fmu, const unsigned *reference, size_t n, int *value) {
    size_t i;
    for (i = 0; i < n; i++) {
        if (reference[i] != DIRECTION)
            return fmu_fails(fmu, "there is no whole number of this value reference");
        value[i] = fmu->now.direction;
    }
    return FMU_OK;
}

static int fmu_set_integer(fmu_instance *fmu, const unsigned *reference, size_t n,
                           const int *value) {
    size_t i;
    for (i = 0; i < n; i++) {
        if (reference[i] != DIRECTION || fmu->now.begun || value[i] < -1 || value[i] > 1)
            return fmu_fails(fmu, "direction is set before the start, to -1, 0 or 1");
        fmu->now.direction = value[i];
    }
    return FMU_OK;
}

static int fmu_get_string(fmu_instance *fmu, const unsigned *reference, size_t n,
                          const char **value) {
    size_t i;
    for (i = 0; i < n; i++) {
        if (reference[i] != SET) return fmu_fails(fmu, "there is no text of this value reference");
        value[i] = damper_sets[fmu->now.set].name;
    }
    return FMU_OK;
}

static int fmu_set_string(fmu_instance *fmu, const unsigned *reference, size_t n,
                          const char *const *value) {
    size_t i;
    for (i = 0; i < n; i++) {
        const damper_set *set = damper_find(value[i]);
        if (reference[i] != SET || fmu->now.begun)
            return fmu_fails(fmu, "set is the only text, and is set before the start");
        if (!set)
            return fmu_fails(fmu, "unknown set: expected nominal, lower, upper or a draw's number");
        fmu->now.set = (int)(set - damper_sets);
    }
    return FMU_OK;
}

/* --- the state, which an importer may store and go back to */

static int fmu_get_state(fmu_instance *fmu, void **stored) {
    if (!*stored) *stored = malloc(sizeof fmu->now);
    if (!*stored) return fmu_fails(fmu, "there is no memory for a state");
    memcpy(*stored, &fmu->now, sizeof fmu->now);
    return FMU_OK;
}

static int fmu_set_state(fmu_instance *fmu, const void *stored) {
    if (!stored) return fmu_fails(fmu, "there is no state to go back to");
    int set = fmu->now.set;
    memcpy(&fmu->now, stored, sizeof fmu->now);
    fmu->now.state.device = &fmu->device;
    if (fmu->now.set != set || !fmu->device.set)
        return fmu_status(fmu, damper_prepare(&fmu->device, &damper_sets[fmu->now.set]));
    return FMU_OK;
}

static int fmu_free_state(void **stored) {
    if (stored) {
        free(*stored);
        *stored = NULL;
    }
    return FMU_OK;
}

/* As bytes, without the pointer to the device, which is another one in another process. */
static int fmu_serialize(fmu_instance *fmu, const void *stored, char *bytes, size_t size) {
    fmu_memory copy;
    if (!stored || size < sizeof copy) return fmu_fails(fmu, "there is no room for the state");
    memcpy(&copy, stored, sizeof copy);
    copy.state.device = NULL;
    memcpy(bytes, &copy, sizeof copy);
    return FMU_OK;
}

static int fmu_deserialize(fmu_instance *fmu, const char *bytes, size_t size, void **stored) {
    fmu_memory copy;
    if (size != sizeof copy) return fmu_fails(fmu, "these bytes are no state of this FMU");
    memcpy(&copy, bytes, sizeof copy);
    if (copy.set < 0 || copy.set >= damper_set_count)
        return fmu_fails(fmu, "these bytes are no state of this FMU");
    if (!*stored) *stored = malloc(sizeof copy);
    if (!*stored) return fmu_fails(fmu, "there is no memory for a state");
    memcpy(*stored, &copy, sizeof copy);
    return FMU_OK;
}

#endif
