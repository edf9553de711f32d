/* The 44 functions of FMI 2.0, over what both standards have in common. */
#include "fmi2Functions.h"
#include "instance.h"

/* Find the instance or give up; without it there is no logger to say more. */
#define FIND(s, c) Instance *s = instance_find(c); if (!s) return fmi2Error
#define WITH(s, c, call) Instance *s = instance_find(c); return s ? STATUS(call) : fmi2Error
#define STATUS(call) ((fmi2Status)(call))

static void log_message(const Instance *s, const char *message)
{
    ((fmi2CallbackLogger)s->logger)(s->environment, s->name, fmi2Error, LOG_CATEGORY, message);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    WITH(s, c, set_logging(s, __func__, on, n, categories));
}

/* -- life -------------------------------------------------------------------------------------------------------- */

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources; (void)visible;
    if (!functions || !functions->logger) return 0;
    const Request request = {
        .kind = type == fmi2ModelExchange ? MODEL_EXCHANGE : CO_SIMULATION, .name = name, .token = guid,
        .logging = logging, .log = log_message, .logger = (void (*)(void))functions->logger,
        .environment = functions->componentEnvironment,
        .objection = type == fmi2ModelExchange || type == fmi2CoSimulation ? 0 : "there is no such kind of FMU",
    };
    return instance_create(__func__, &request);
}

void fmi2FreeInstance(fmi2Component c) { instance_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    FIND(s, c);
    (void)tolerance_defined; (void)tolerance; /* the parameter solver.tolerance says it */
    return STATUS(set_experiment(s, __func__, start, stop_defined, stop));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    FIND(s, c);
    if (!s->now.timed) return STATUS(refuse(s, __func__, "fmi2SetupExperiment has to come first"));
    return STATUS(enter_initialisation(s, __func__));
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { WITH(s, c, leave_initialisation(s, __func__)); }
fmi2Status fmi2Terminate(fmi2Component c) { WITH(s, c, change_mode(s, __func__, EVENT | CONTINUOUS | STEP, TERMINATED)); }
fmi2Status fmi2Reset(fmi2Component c) { WITH(s, c, instance_reset(s)); }

/* -- variables --------------------------------------------------------------------------------------------------- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    WITH(s, c, get_reals(s, __func__, vr, n, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    WITH(s, c, set_reals(s, __func__, vr, n, value));
}

static fmi2Status get_ints(fmi2Component c, const char *who, const unsigned vr[], size_t n, int value[], unsigned type)
{
    FIND(s, c);
    if (begin_get(s, who, vr, n, value)) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        double x;
        if (get_one(s, who, vr[i], type, &x)) return fmi2Error;
        value[i] = (int)x;
    }
    return fmi2OK;
}

static fmi2Status set_ints(fmi2Component c, const char *who, const unsigned vr[], size_t n, const int value[], unsigned type)
{
    FIND(s, c);
    if (begin_set(s, who, vr, n, value)) return fmi2Error;
    for (size_t i = 0; i < n; i++)
        if (check_one(s, who, vr[i], type, value[i])) return fmi2Error;
    for (size_t i = 0; i < n; i++) assign(s, vr[i], value[i]);
    return fmi2OK;
}

/* An enumeration is read and set as an integer, too. */
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    return get_ints(c, __func__, vr, n, value, ENUMERATION | INTEGER);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    return set_ints(c, __func__, vr, n, value, ENUMERATION | INTEGER);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
{
    return get_ints(c, __func__, vr, n, value, BOOLEAN);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
{
    return set_ints(c, __func__, vr, n, value, BOOLEAN);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    FIND(s, c);
    (void)vr; (void)value;
    return STATUS(no_variable(s, __func__, n));
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    FIND(s, c);
    (void)vr; (void)value;
    return STATUS(no_variable(s, __func__, n));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                        fmi2Real sensitivity[])
{
    WITH(s, c, directional_derivative(s, __func__, unknown, n_unknown, known, n_known, seed, sensitivity));
}

/* -- states of the whole instance -------------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { WITH(s, c, state_get(s, __func__, state)); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { WITH(s, c, state_set(s, __func__, state)); }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { WITH(s, c, state_free(s, __func__, state)); }

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    WITH(s, c, state_size(s, __func__, state, size));
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    WITH(s, c, state_serialise(s, __func__, state, bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    WITH(s, c, state_deserialise(s, __func__, bytes, size, state));
}

/* -- model exchange ---------------------------------------------------------------------------------------------- */

fmi2Status fmi2EnterEventMode(fmi2Component c) { WITH(s, c, event_mode(s, __func__)); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { WITH(s, c, change_mode(s, __func__, EVENT, CONTINUOUS)); }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    FIND(s, c);
    if (check_outputs(s, __func__, EVENT, 1, (const void *[]){info})) return fmi2Error;
    info->newDiscreteStatesNeeded = info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = info->valuesOfContinuousStatesChanged = fmi2False;
    info->nextEventTimeDefined = fmi2False;
    info->nextEventTime = 0.0;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean keep, fmi2Boolean *event, fmi2Boolean *terminate)
{
    FIND(s, c);
    (void)keep;
    if (check_outputs(s, __func__, CONTINUOUS, 2, (const void *[]){event, terminate})) return fmi2Error;
    *event = *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { WITH(s, c, set_time(s, __func__, time)); }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { WITH(s, c, set_states(s, __func__, x, n)); }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { WITH(s, c, get_states(s, __func__, x, n)); }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { WITH(s, c, get_derivatives(s, __func__, dx, n)); }

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    WITH(s, c, get_nominals(s, __func__, x, n));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    FIND(s, c);
    (void)indicators;
    return n ? STATUS(refuse(s, __func__, "there are no event indicators")) : fmi2OK;
}

/* -- co-simulation ----------------------------------------------------------------------------------------------- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real point, fmi2Real h, fmi2Boolean keep)
{
    FIND(s, c);
    (void)keep;
    return STATUS(instance_step(s, __func__, point, h));
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    FIND(s, c);
    if (check_outputs(s, __func__, STEP | FAILED | TERMINATED, 1, (const void *[]){value})) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return STATUS(refuse(s, __func__, "only fmi2LastSuccessfulTime is a real status"));
    *value = s->now.core.v[0];
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    FIND(s, c);
    if (check_outputs(s, __func__, STEP | FAILED | TERMINATED, 1, (const void *[]){value})) return fmi2Error;
    if (kind != fmi2Terminated) return STATUS(refuse(s, __func__, "only fmi2Terminated is a boolean status"));
    *value = fmi2False;
    return fmi2OK;
}

/* -- what this FMU does not have: every call is an error ---------------------------------------------------------- */

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#define ABSENT(c, reason) do { WITH(s, c, refuse(s, __func__, reason)); } while (0)

fmi2Status fmi2CancelStep(fmi2Component c) { ABSENT(c, "no step is ever pending"); }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) { ABSENT(c, "no step is ever pending"); }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) { ABSENT(c, "there is none"); }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) { ABSENT(c, "there is none"); }

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[])
{
    ABSENT(c, "inputs are held, not interpolated");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                        fmi2Real value[])
{
    ABSENT(c, "derivatives of outputs are not provided");
}
