/* FMI 3.0 for co-simulation: see fmu.h. */
#include "fmu.h"

#include <stdbool.h>
#include <stdint.h>

typedef void (*fmi3_logger)(void *environment, int status, const char *category,
                            const char *message);
typedef void (*fmi3_update)(void *environment, double time, bool set_requested, bool get_allowed,
                            bool finished, bool can_return, bool *requested, double *return_time);

#ifdef FMI3_FUNCTION_PREFIX
#define NAME(function) FMU_NAME(FMI3_FUNCTION_PREFIX, function)
#else
#define NAME(function) function
#endif
#define UNUSED(argument) (void)(argument)

union logger { /* a pointer to a function does not fit a pointer to an object by the standard */
    fmi3_logger call;
    void *object;
};

static void write_log(void *instance, int status, const char *message) {
    fmu_instance *fmu = instance;
    union logger logger;
    logger.object = fmu->callback;
    if (logger.object)
        logger.call(fmu->environment, status,
                    status == FMU_WARNING ? "logStatusWarning" : "logStatusError", message);
}

FMU_EXPORT const char *NAME(fmi3GetVersion)(void) { return "3.0"; }

FMU_EXPORT int NAME(fmi3SetDebugLogging)(void *c, bool on, size_t n,
                                         const char *const categories[]) {
    UNUSED(c), UNUSED(on), UNUSED(n), UNUSED(categories);
    return FMU_OK;
}

FMU_EXPORT void *NAME(fmi3InstantiateCoSimulation)(const char *name, const char *token,
                                                   const char *resources, bool visible,
                                                   bool logging, bool events, bool early,
                                                   const uint32_t required[], size_t n,
                                                   void *environment, fmi3_logger logger,
                                                   fmi3_update update) {
    fmu_instance *fmu = events ? NULL : fmu_new(name, token, write_log);
    union logger callback;
    UNUSED(resources), UNUSED(visible), UNUSED(logging), UNUSED(early);
    UNUSED(required), UNUSED(n), UNUSED(update);
    if (!fmu) {
        if (logger)
            logger(environment, FMU_ERROR, "logStatusError",
                   "this FMU has no events, and its token is that of its modelDescription.xml");
        return NULL;
    }
    callback.object = NULL;
    callback.call = logger;
    fmu->callback = callback.object;
    fmu->environment = environment;
    return fmu;
}

FMU_EXPORT void NAME(fmi3FreeInstance)(void *c) { fmu_free(c); }

FMU_EXPORT int NAME(fmi3EnterInitializationMode)(void *c, bool tolerant, double tolerance,
                                                 double start, bool stops, double stop) {
    UNUSED(tolerant), UNUSED(tolerance), UNUSED(stops), UNUSED(stop);
    ((fmu_instance *)c)->now.time = start;
    return FMU_OK;
}

FMU_EXPORT int NAME(fmi3ExitInitializationMode)(void *c) {
    int status = fmu_begin(c);
    if (status < FMU_ERROR) ((fmu_instance *)c)->now.begun = 1;
    return status;
}

FMU_EXPORT int NAME(fmi3Terminate)(void *c) {
    UNUSED(c);
    return FMU_OK;
}

FMU_EXPORT int NAME(fmi3Reset)(void *c) {
    fmu_reset(c);
    return FMU_OK;
}

FMU_EXPORT int NAME(fmi3GetFloat64)(void *c, const uint32_t r[], size_t n, double value[],
                                    size_t m) {
    if (n != m) return fmu_fails(c, "every variable is one number");
    return fmu_get_real(c, r, n, value);
}
FMU_EXPORT int NAME(fmi3SetFloat64)(void *c, const uint32_t r[], size_t n, const double value[],
                                    size_t m) {
    if (n != m) return fmu_fails(c, "every variable is one number");
    return fmu_set_real(c, r, n, value);
}
FMU_EXPORT int NAME(fmi3GetInt32)(void *c, const uint32_t r[], size_t n, int32_t value[],
                                  size_t m) {
    if (n != m) return fmu_fails(c, "every variable is one number");
    return fmu_get_integer(c, r, n, value);
}
FMU_EXPORT int NAME(fmi3SetInt32)(void *c, const uint32_t r[], size_t n, const int32_t value[],
                                  size_t m) {
    if (n != m) return fmu_fails(c, "every variable is one number");
    return fmu_set_integer(c, r, n, value);
}
FMU_EXPORT int NAME(fmi3GetString)(void *c, const uint32_t r[], size_t n, const char *value[],
                                   size_t m) {
    if (n != m) return fmu_fails(c, "every variable is one text");
    return fmu_get_string(c, r, n, value);
}
FMU_EXPORT int NAME(fmi3SetString)(void *c, const uint32_t r[], size_t n,
                                   const char *const value[], size_t m) {
    if (n != m) return fmu_fails(c, "every variable is one text");
    return fmu_set_string(c, r, n, value);
}

FMU_EXPORT int NAME(fmi3GetFMUState)(void *c, void **stored) { return fmu_get_state(c, stored); }
FMU_EXPORT int NAME(fmi3SetFMUState)(void *c, void *stored) { return fmu_set_state(c, stored); }
FMU_EXPORT int NAME(fmi3FreeFMUState)(void *c, void **stored) {
    UNUSED(c);
    return fmu_free_state(stored);
}
FMU_EXPORT int NAME(fmi3SerializedFMUStateSize)(void *c, void *stored, size_t *size) {
    UNUSED(c), UNUSED(stored);
    *size = sizeof(fmu_memory);
    return FMU_OK;
}
FMU_EXPORT int NAME(fmi3SerializeFMUState)(void *c, void *stored, uint8_t bytes[], size_t size) {
    return fmu_serialize(c, stored, (char *)bytes, size);
}
FMU_EXPORT int NAME(fmi3DeserializeFMUState)(void *c, const uint8_t bytes[], size_t size,
                                             void **stored) {
    return fmu_deserialize(c, (const char *)bytes, size, stored);
}

FMU_EXPORT int NAME(fmi3DoStep)(void *c, double time, double size, bool no_set_state, bool *event,
                                bool *terminate, bool *early, double *last) {
    int status = fmu_step(c, time, size);
    UNUSED(no_set_state);
    *event = *terminate = *early = false;
    *last = ((fmu_instance *)c)->now.time;
    return status;
}

/* What modelDescription.xml says that it has not, or cannot do: importers look for the names. */
#define ARGUMENTS void *c, const uint32_t r[], size_t n
#define NONE(name, type)                                                                          \
    FMU_EXPORT int NAME(fmi3Get##name)(ARGUMENTS, type v[], size_t m) {                           \
        UNUSED(r), UNUSED(v), UNUSED(m);                                                          \
        return n ? fmu_fails(c, "no variable is of this type") : FMU_OK;                          \
    }                                                                                             \
    FMU_EXPORT int NAME(fmi3Set##name)(ARGUMENTS, const type v[], size_t m) {                     \
        UNUSED(r), UNUSED(v), UNUSED(m);                                                          \
        return n ? fmu_fails(c, "no variable is of this type") : FMU_OK;                          \
    }
NONE(Float32, float)
NONE(Int8, int8_t)
NONE(UInt8, uint8_t)
NONE(Int16, int16_t)
NONE(UInt16, uint16_t)
NONE(UInt32, uint32_t)
NONE(Int64, int64_t)
NONE(UInt64, uint64_t)
NONE(Boolean, bool)

/* Those of which only the name matters: they are never called. */
#define NEVER(name)                                                                               \
    FMU_EXPORT int NAME(fmi3##name)(void *c) { return fmu_fails(c, "fmi3" #name " is not there"); }
NEVER(GetBinary)
NEVER(SetBinary)
NEVER(GetClock)
NEVER(SetClock)
NEVER(GetNumberOfVariableDependencies)
NEVER(GetVariableDependencies)
NEVER(GetDirectionalDerivative)
NEVER(GetAdjointDerivative)
NEVER(EnterConfigurationMode)
NEVER(ExitConfigurationMode)
NEVER(GetIntervalDecimal)
NEVER(GetIntervalFraction)
NEVER(GetShiftDecimal)
NEVER(GetShiftFraction)
NEVER(SetIntervalDecimal)
NEVER(SetIntervalFraction)
NEVER(SetShiftDecimal)
NEVER(SetShiftFraction)
NEVER(EvaluateDiscreteStates)
NEVER(UpdateDiscreteStates)
NEVER(EnterEventMode)
NEVER(EnterContinuousTimeMode)
NEVER(CompletedIntegratorStep)
NEVER(SetTime)
NEVER(SetContinuousStates)
NEVER(GetContinuousStateDerivatives)
NEVER(GetEventIndicators)
NEVER(GetContinuousStates)
NEVER(GetNominalsOfContinuousStates)
NEVER(GetNumberOfEventIndicators)
NEVER(GetNumberOfContinuousStates)
NEVER(EnterStepMode)
NEVER(GetOutputDerivatives)
NEVER(ActivateModelPartition)

FMU_EXPORT void *NAME(fmi3InstantiateModelExchange)(void) { return NULL; }
FMU_EXPORT void *NAME(fmi3InstantiateScheduledExecution)(void) { return NULL; }
