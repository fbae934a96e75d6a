// Reads what XLA hands to a custom call: see jaxlib's c_api.h, which stands above in the same text.

// XLA asks each call once for which version of the interface it was compiled, and what it may do.
static bool answered(XLA_FFI_CallFrame* frame, XLA_FFI_Handler_Traits traits) {
  auto extension = frame->extension_start;  // its type was renamed in jaxlib 0.11
  if (extension == nullptr || extension->type != XLA_FFI_Extension_Metadata) return false;
  XLA_FFI_Metadata* metadata = ((XLA_FFI_Metadata_Extension*)extension)->metadata;
  metadata->api_version.major_version = XLA_FFI_API_MAJOR;
  metadata->api_version.minor_version = XLA_FFI_API_MINOR;
  metadata->traits = traits;
  return true;
}

static Arrays arrays(XLA_FFI_CallFrame* frame) {
  auto in = [=](int k) { return (XLA_FFI_Buffer*)frame->args.args[k]; };
  auto out = [=](int k) { return (float*)((XLA_FFI_Buffer*)frame->rets.rets[k])->data; };
  Arrays a;
  a.qpos = (const float*)in(0)->data;
  a.qvel = (const float*)in(1)->data;
  a.warmstart = (const float*)in(2)->data;
  a.control = (const float*)in(3)->data;
  a.range = (const float*)in(4)->data;
  a.order = frame->args.size > 5 ? (const int*)in(5)->data : nullptr;
  a.qpos_after = out(0);
  a.qvel_after = out(1);
  a.warmstart_after = out(2);
  a.sensors = out(3);
  a.n = in(0)->dims[0];
  a.substeps = *(const int32_t*)((XLA_FFI_Scalar*)frame->attrs.attrs[0])->value;
  return a;
}

static XLA_FFI_Error* failure(XLA_FFI_CallFrame* frame, const char* message) {
  XLA_FFI_Error_Create_Args args = {sizeof args, nullptr, message, XLA_FFI_Error_Code_INTERNAL};
  return frame->api->XLA_FFI_Error_Create(&args);
}

static void forget(XLA_FFI_CallFrame* frame, XLA_FFI_Error* error) {
  XLA_FFI_Error_Destroy_Args args = {sizeof args, nullptr, error};
  frame->api->XLA_FFI_Error_Destroy(&args);
}
