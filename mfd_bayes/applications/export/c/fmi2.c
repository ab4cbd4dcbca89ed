/* FMI 2.0 for co-simulation: see fmu.h. */
#include "fmu.h"

typedef void (*fmi2_logger)(void *environment, const char *name, int status, const char *category,
                            const char *message, ...);
typedef struct {
    fmi2_logger logger;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *object);
    void (*step_finished)(void *environment, int status);
    void *environment;
} fmi2_callbacks;

#ifdef FMI2_FUNCTION_PREFIX
#define NAME(function) FMU_NAME(FMI2_FUNCTION_PREFIX, function)
#else
#define NAME(function) function
#endif
#define UNUSED(argument) (void)(argument)

static void write_log(void *instance, int status, const char *message) {
    fmu_instance *fmu = instance;
    const fmi2_callbacks *callbacks = fmu->callback;
    if (callbacks && callbacks->logger)
        callbacks->logger(fmu->environment, fmu->name, status,
                          status == FMU_WARNING ? "logStatusWarning" : "logStatusError", "%s",
                          message);
}

FMU_EXPORT const char *NAME(fmi2GetTypesPlatform)(void) { return "default"; }
FMU_EXPORT const char *NAME(fmi2GetVersion)(void) { return "2.0"; }

FMU_EXPORT int NAME(fmi2SetDebugLogging)(void *c, int on, size_t n,
                                         const char *const categories[]) {
    UNUSED(c), UNUSED(on), UNUSED(n), UNUSED(categories);
    return FMU_OK;
}

FMU_EXPORT void *NAME(fmi2Instantiate)(const char *name, int type, const char *token,
                                       const char *resources, const fmi2_callbacks *callbacks,
                                       int visible, int logging) {
    fmu_instance *fmu;
    UNUSED(resources), UNUSED(visible), UNUSED(logging);
    fmu = type == 1 ? fmu_new(name, token, write_log) : NULL; /* 1: co-simulation */
    if (!fmu) {
        if (callbacks && callbacks->logger)
            callbacks->logger(callbacks->environment, name, FMU_ERROR, "logStatusError",
                              "this FMU is for co-simulation, and of another modelDescription.xml");
        return NULL;
    }
    if (callbacks) {
        fmu->callback = (void *)callbacks;
        fmu->environment = callbacks->environment;
    }
    return fmu;
}

FMU_EXPORT void NAME(fmi2FreeInstance)(void *c) { fmu_free(c); }

FMU_EXPORT int NAME(fmi2SetupExperiment)(void *c, int tolerant, double tolerance, double start,
                                         int stops, double stop) {
    UNUSED(tolerant), UNUSED(tolerance), UNUSED(stops), UNUSED(stop);
    ((fmu_instance *)c)->now.time = start;
    return FMU_OK;
}

FMU_EXPORT int NAME(fmi2EnterInitializationMode)(void *c) {
    UNUSED(c);
    return FMU_OK;
}

FMU_EXPORT int NAME(fmi2ExitInitializationMode)(void *c) {
    int status = fmu_begin(c);
    if (status < FMU_ERROR) ((fmu_instance *)c)->now.begun = 1;
    return status;
}

FMU_EXPORT int NAME(fmi2Terminate)(void *c) {
    UNUSED(c);
    return FMU_OK;
}

FMU_EXPORT int NAME(fmi2Reset)(void *c) {
    fmu_reset(c);
    return FMU_OK;
}

FMU_EXPORT int NAME(fmi2GetReal)(void *c, const unsigned r[], size_t n, double value[]) {
    return fmu_get_real(c, r, n, value);
}
FMU_EXPORT int NAME(fmi2SetReal)(void *c, const unsigned r[], size_t n, const double value[]) {
    return fmu_set_real(c, r, n, value);
}
FMU_EXPORT int NAME(fmi2GetInteger)(void *c, const unsigned r[], size_t n, int value[]) {
    return fmu_get_integer(c, r, n, value);
}
FMU_EXPORT int NAME(fmi2SetInteger)(void *c, const unsigned r[], size_t n, const int value[]) {
    return fmu_set_integer(c, r, n, value);
}
FMU_EXPORT int NAME(fmi2GetString)(void *c, const unsigned r[], size_t n, const char *value[]) {
    return fmu_get_string(c, r, n, value);
}
FMU_EXPORT int NAME(fmi2SetString)(void *c, const unsigned r[], size_t n,
                                   const char *const value[]) {
    return fmu_set_string(c, r, n, value);
}
FMU_EXPORT int NAME(fmi2GetBoolean)(void *c, const unsigned r[], size_t n, int value[]) {
    UNUSED(r), UNUSED(value);
    return n ? fmu_fails(c, "there is no truth value") : FMU_OK;
}
FMU_EXPORT int NAME(fmi2SetBoolean)(void *c, const unsigned r[], size_t n, const int value[]) {
    UNUSED(r), UNUSED(value);
    return n ? fmu_fails(c, "there is no truth value") : FMU_OK;
}

FMU_EXPORT int NAME(fmi2GetFMUstate)(void *c, void **stored) { return fmu_get_state(c, stored); }
FMU_EXPORT int NAME(fmi2SetFMUstate)(void *c, void *stored) { return fmu_set_state(c, stored); }
FMU_EXPORT int NAME(fmi2FreeFMUstate)(void *c, void **stored) {
    UNUSED(c);
    return fmu_free_state(stored);
}
FMU_EXPORT int NAME(fmi2SerializedFMUstateSize)(void *c, void *stored, size_t *size) {
    UNUSED(c), UNUSED(stored);
    *size = sizeof(fmu_memory);
    return FMU_OK;
}
FMU_EXPORT int NAME(fmi2SerializeFMUstate)(void *c, void *stored, char bytes[], size_t size) {
    return fmu_serialize(c, stored, bytes, size);
}
FMU_EXPORT int NAME(fmi2DeSerializeFMUstate)(void *c, const char bytes[], size_t size,
                                             void **stored) {
    return fmu_deserialize(c, bytes, size, stored);
}

FMU_EXPORT int NAME(fmi2DoStep)(void *c, double time, double size, int no_set_state) {
    UNUSED(no_set_state);
    return fmu_step(c, time, size);
}

/* What modelDescription.xml says that it cannot do. */
FMU_EXPORT int NAME(fmi2GetDirectionalDerivative)(void *c, const unsigned unknown[], size_t n,
                                       const unsigned known[], size_t m, const double seed[],
                                       double value[]) {
    UNUSED(unknown), UNUSED(n), UNUSED(known), UNUSED(m), UNUSED(seed), UNUSED(value);
    return fmu_fails(c, "there are no derivatives");
}
FMU_EXPORT int NAME(fmi2SetRealInputDerivatives)(void *c, const unsigned r[], size_t n,
                                                 const int order[], const double value[]) {
    UNUSED(r), UNUSED(n), UNUSED(order), UNUSED(value);
    return fmu_fails(c, "there are no derivatives");
}
FMU_EXPORT int NAME(fmi2GetRealOutputDerivatives)(void *c, const unsigned r[], size_t n,
                                                  const int order[], double value[]) {
    UNUSED(r), UNUSED(n), UNUSED(order), UNUSED(value);
    return fmu_fails(c, "there are no derivatives");
}
FMU_EXPORT int NAME(fmi2CancelStep)(void *c) {
    return fmu_fails(c, "a step ends before it can be cancelled");
}
FMU_EXPORT int NAME(fmi2GetStatus)(void *c, int kind, int *value) {
    UNUSED(c), UNUSED(kind), UNUSED(value);
    return FMU_DISCARD;
}
FMU_EXPORT int NAME(fmi2GetRealStatus)(void *c, int kind, double *value) {
    if (kind != 2) return FMU_DISCARD; /* 2: the last successful time */
    *value = ((fmu_instance *)c)->now.time;
    return FMU_OK;
}
FMU_EXPORT int NAME(fmi2GetIntegerStatus)(void *c, int kind, int *value) {
    UNUSED(c), UNUSED(kind), UNUSED(value);
    return FMU_DISCARD;
}
FMU_EXPORT int NAME(fmi2GetBooleanStatus)(void *c, int kind, int *value) {
    UNUSED(c);
    if (kind != 3) return FMU_DISCARD; /* 3: whether it wants to end */
    *value = 0;
    return FMU_OK;
}
FMU_EXPORT int NAME(fmi2GetStringStatus)(void *c, int kind, const char **value) {
    UNUSED(c), UNUSED(kind), UNUSED(value);
    return FMU_DISCARD;
}
