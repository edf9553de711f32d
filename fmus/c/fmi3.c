/* The 75 functions of FMI 3.0, over what both standards have in common. */
#include "fmi3Functions.h"
#include "instance.h"

/* Find the instance or give up; without it there is no logger to say more. */
#define FIND(s, c) Instance *s = instance_find(c); if (!s) return fmi3Error
#define WITH(s, c, call) Instance *s = instance_find(c); return s ? STATUS(call) : fmi3Error
#define STATUS(call) ((fmi3Status)(call))

static void log_message(const Instance *s, const char *message)
{
    ((fmi3LogMessageCallback)s->logger)(s->environment, fmi3Error, LOG_CATEGORY, message);
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    WITH(s, c, set_logging(s, __func__, on, n, categories));
}

/* -- life -------------------------------------------------------------------------------------------------------- */

static Request request_of(int kind, fmi3String name, fmi3String token, fmi3Boolean logging, void *environment,
                          fmi3LogMessageCallback log)
{
    const Request request = {.kind = kind, .name = name, .token = token, .logging = logging, .log = log_message,
                             .logger = (void (*)(void))log, .environment = environment};
    return request;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)resources; (void)visible;
    const Request request = request_of(MODEL_EXCHANGE, name, token, logging, environment, log);
    return instance_create(__func__, &request);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n_intermediate,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)resources; (void)visible; (void)early_return; (void)intermediate; (void)update; /* allowed, but never used */
    Request request = request_of(CO_SIMULATION, name, token, logging, environment, log);
    if (event_mode) request.objection = "this FMU has no event mode in Co-Simulation";
    if (n_intermediate) request.objection = "this FMU provides no intermediate updates";
    return instance_create(__func__, &request);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log, fmi3ClockUpdateCallback clock,
                                               fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    (void)resources; (void)visible; (void)clock; (void)lock; (void)unlock;
    Request request = request_of(CO_SIMULATION, name, token, logging, environment, log);
    request.objection = "this FMU offers no Scheduled Execution";
    return instance_create(__func__, &request);
}

void fmi3FreeInstance(fmi3Instance c) { instance_free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stop_defined, fmi3Float64 stop)
{
    FIND(s, c);
    (void)tolerance_defined; (void)tolerance; /* the parameter solver.tolerance says it */
    return STATUS(set_experiment(s, __func__, start, stop_defined, stop) ? ERROR : enter_initialisation(s, __func__));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { WITH(s, c, leave_initialisation(s, __func__)); }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { WITH(s, c, event_mode(s, __func__)); }
fmi3Status fmi3Terminate(fmi3Instance c) { WITH(s, c, change_mode(s, __func__, EVENT | CONTINUOUS | STEP, TERMINATED)); }
fmi3Status fmi3Reset(fmi3Instance c) { WITH(s, c, instance_reset(s)); }

/* -- variables --------------------------------------------------------------------------------------------------- */

/* All variables are scalars: as many values as value references. */
static int count(const Instance *s, const char *who, size_t n, size_t n_values)
{
    return n == n_values ? OK : refuse(s, who, "%lu value references, but %lu values", (unsigned long)n, (unsigned long)n_values);
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t n_values)
{
    WITH(s, c, n != n_values ? count(s, __func__, n, n_values) : get_reals(s, __func__, vr, n, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[], size_t n_values)
{
    WITH(s, c, n != n_values ? count(s, __func__, n, n_values) : set_reals(s, __func__, vr, n, values));
}

/* An enumeration is read and set as an Int64. */
#define ACCESSORS(Name, Type, TYPE) \
    fmi3Status fmi3Get##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, Type values[], size_t n_values) \
    { \
        FIND(s, c); \
        if (count(s, __func__, n, n_values) || begin_get(s, __func__, vr, n, values)) return fmi3Error; \
        for (size_t i = 0; i < n; i++) { \
            double x; \
            if (get_one(s, __func__, vr[i], TYPE, &x)) return fmi3Error; \
            values[i] = (Type)x; \
        } \
        return fmi3OK; \
    } \
    fmi3Status fmi3Set##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const Type values[], size_t n_values) \
    { \
        FIND(s, c); \
        if (count(s, __func__, n, n_values) || begin_set(s, __func__, vr, n, values)) return fmi3Error; \
        for (size_t i = 0; i < n; i++) \
            if (check_one(s, __func__, vr[i], TYPE, (double)values[i])) return fmi3Error; \
        for (size_t i = 0; i < n; i++) assign(s, vr[i], (double)values[i]); \
        return fmi3OK; \
    }

ACCESSORS(Int64, fmi3Int64, ENUMERATION)
ACCESSORS(Int32, fmi3Int32, INTEGER)
ACCESSORS(Boolean, fmi3Boolean, BOOLEAN)

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                        const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                        fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    FIND(s, c);
    if (count(s, __func__, n_knowns, n_seed) || count(s, __func__, n_unknowns, n_sensitivity)) return fmi3Error;
    return STATUS(directional_derivative(s, __func__, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity));
}

/* -- states of the whole instance -------------------------------------------------------------------------------- */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { WITH(s, c, state_get(s, __func__, state)); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { WITH(s, c, state_set(s, __func__, state)); }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) { WITH(s, c, state_free(s, __func__, state)); }

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    WITH(s, c, state_size(s, __func__, state, size));
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    WITH(s, c, state_serialise(s, __func__, state, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    WITH(s, c, state_deserialise(s, __func__, bytes, size, state));
}

/* -- model exchange ---------------------------------------------------------------------------------------------- */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { WITH(s, c, change_mode(s, __func__, EVENT, CONTINUOUS)); }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *next_defined, fmi3Float64 *next)
{
    FIND(s, c);
    const void *const results[] = {again, terminate, nominals, values, next_defined, next};
    if (check_outputs(s, __func__, EVENT, 6, results)) return fmi3Error;
    *again = *terminate = *nominals = *values = *next_defined = fmi3False;
    *next = 0.0;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *terminate)
{
    FIND(s, c);
    (void)keep;
    if (check_outputs(s, __func__, CONTINUOUS, 2, (const void *[]){event, terminate})) return fmi3Error;
    *event = *terminate = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { WITH(s, c, set_time(s, __func__, time)); }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { WITH(s, c, set_states(s, __func__, x, n)); }
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { WITH(s, c, get_states(s, __func__, x, n)); }

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n)
{
    WITH(s, c, get_derivatives(s, __func__, dx, n));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n)
{
    WITH(s, c, get_nominals(s, __func__, x, n));
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { WITH(s, c, count_states(s, __func__, n)); }

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n)
{
    FIND(s, c);
    (void)indicators;
    return n ? STATUS(refuse(s, __func__, "there are no event indicators")) : fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    FIND(s, c);
    if (count_states(s, __func__, n)) return fmi3Error;
    *n = 0;
    return fmi3OK;
}

/* -- co-simulation ----------------------------------------------------------------------------------------------- */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 point, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    FIND(s, c);
    (void)keep;
    if (check_outputs(s, __func__, STEP, 4, (const void *[]){event, terminate, early, last})) return fmi3Error;
    const int status = instance_step(s, __func__, point, h);
    *event = *terminate = *early = fmi3False;
    *last = s->now.core.v[0];
    return STATUS(status);
}

/* -- what this FMU does not have: every call is an error ---------------------------------------------------------- */

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#define ABSENT(c, reason) do { WITH(s, c, refuse(s, __func__, reason)); } while (0)
#define NO_SUCH_TYPE(Name, Type) \
    fmi3Status fmi3Get##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, Type values[], size_t n_values) \
    { \
        WITH(s, c, no_variable(s, __func__, n)); \
    } \
    fmi3Status fmi3Set##Name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const Type values[], size_t n_values) \
    { \
        WITH(s, c, no_variable(s, __func__, n)); \
    }

NO_SUCH_TYPE(Float32, fmi3Float32)
NO_SUCH_TYPE(Int8, fmi3Int8)
NO_SUCH_TYPE(UInt8, fmi3UInt8)
NO_SUCH_TYPE(Int16, fmi3Int16)
NO_SUCH_TYPE(UInt16, fmi3UInt16)
NO_SUCH_TYPE(UInt32, fmi3UInt32)
NO_SUCH_TYPE(UInt64, fmi3UInt64)
NO_SUCH_TYPE(String, fmi3String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary values[],
                         size_t n_values)
{
    WITH(s, c, no_variable(s, __func__, n));
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[], const fmi3Binary values[],
                         size_t n_values)
{
    WITH(s, c, no_variable(s, __func__, n));
}

#define CLOCKLESS(c) ABSENT(c, "this FMU has no clocks")
#define VRS fmi3Instance c, const fmi3ValueReference vr[], size_t n

fmi3Status fmi3GetClock(VRS, fmi3Clock values[]) { CLOCKLESS(c); }
fmi3Status fmi3SetClock(VRS, const fmi3Clock values[]) { CLOCKLESS(c); }
fmi3Status fmi3GetIntervalDecimal(VRS, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]) { CLOCKLESS(c); }
fmi3Status fmi3GetIntervalFraction(VRS, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    CLOCKLESS(c);
}
fmi3Status fmi3GetShiftDecimal(VRS, fmi3Float64 shifts[]) { CLOCKLESS(c); }
fmi3Status fmi3GetShiftFraction(VRS, fmi3UInt64 counters[], fmi3UInt64 resolutions[]) { CLOCKLESS(c); }
fmi3Status fmi3SetIntervalDecimal(VRS, const fmi3Float64 intervals[]) { CLOCKLESS(c); }
fmi3Status fmi3SetIntervalFraction(VRS, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) { CLOCKLESS(c); }
fmi3Status fmi3SetShiftDecimal(VRS, const fmi3Float64 shifts[]) { CLOCKLESS(c); }
fmi3Status fmi3SetShiftFraction(VRS, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) { CLOCKLESS(c); }
fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) { CLOCKLESS(c); }
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { ABSENT(c, "this FMU has no discrete states to evaluate"); }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { ABSENT(c, "this FMU has no event mode in Co-Simulation"); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { ABSENT(c, "this FMU has no structural parameters"); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { ABSENT(c, "this FMU has no structural parameters"); }

fmi3Status fmi3GetOutputDerivatives(VRS, const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values)
{
    ABSENT(c, "derivatives of outputs are not provided");
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n)
{
    ABSENT(c, "the dependencies stand in modelDescription.xml");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t dependent_elements[],
                                       fmi3ValueReference independents[], size_t independent_elements[],
                                       fmi3DependencyKind kinds[], size_t n)
{
    ABSENT(c, "the dependencies stand in modelDescription.xml");
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns,
                                    const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                    fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    ABSENT(c, "adjoint derivatives are not provided; use directional ones");
}
