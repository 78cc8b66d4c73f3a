/*
 * The OpenCL 1.2 entry points that `cl-sys` 0.4 declares, one row each, for loader.c to expand:
 * STATUS returns a cl_int; HANDLE returns a pointer and stores its status in `error`; ADDRESS returns a pointer.
 */
STATUS(clGetPlatformIDs, (cl_uint num_entries, handle *platforms, cl_uint *num_platforms), (num_entries, platforms,
       num_platforms))
STATUS(clGetPlatformInfo, (handle platform, cl_uint what, size_t size, void *value, size_t *size_ret), (platform,
       what, size, value, size_ret))
STATUS(clGetDeviceIDs, (handle platform, cl_flags device_type, cl_uint num_entries, handle *devices, cl_uint
       *num_devices), (platform, device_type, num_entries, devices, num_devices))
STATUS(clGetDeviceInfo, (handle device, cl_uint what, size_t size, void *value, size_t *size_ret), (device, what,
       size, value, size_ret))
STATUS(clCreateSubDevices, (handle in_device, const intptr_t *properties, cl_uint num_devices, handle *out_devices,
       cl_uint *num_devices_ret), (in_device, properties, num_devices, out_devices, num_devices_ret))
STATUS(clRetainDevice, (handle device), (device))
STATUS(clReleaseDevice, (handle device), (device))
HANDLE(clCreateContext, (const intptr_t *properties, cl_uint num_devices, const handle *devices, callback pfn_notify,
       void *user_data, cl_int *error), (properties, num_devices, devices, pfn_notify, user_data, error))
HANDLE(clCreateContextFromType, (const intptr_t *properties, cl_flags device_type, callback pfn_notify, void
       *user_data, cl_int *error), (properties, device_type, pfn_notify, user_data, error))
STATUS(clRetainContext, (handle context), (context))
STATUS(clReleaseContext, (handle context), (context))
STATUS(clGetContextInfo, (handle context, cl_uint what, size_t size, void *value, size_t *size_ret), (context, what,
       size, value, size_ret))
HANDLE(clCreateCommandQueue, (handle context, handle device, cl_flags properties, cl_int *error), (context, device,
       properties, error))
STATUS(clRetainCommandQueue, (handle queue), (queue))
STATUS(clReleaseCommandQueue, (handle queue), (queue))
STATUS(clGetCommandQueueInfo, (handle queue, cl_uint what, size_t size, void *value, size_t *size_ret), (queue, what,
       size, value, size_ret))
HANDLE(clCreateBuffer, (handle context, cl_flags flags, size_t size, void *host_ptr, cl_int *error), (context, flags,
       size, host_ptr, error))
HANDLE(clCreateSubBuffer, (handle buffer, cl_flags flags, cl_uint buffer_create_type, const void *buffer_create_info,
       cl_int *error), (buffer, flags, buffer_create_type, buffer_create_info, error))
HANDLE(clCreateImage2D, (handle context, cl_flags flags, void *image_format, size_t image_width, size_t image_depth,
       size_t image_slc_pitch, void *host_ptr, cl_int *error), (context, flags, image_format, image_width,
       image_depth, image_slc_pitch, host_ptr, error))
HANDLE(clCreateImage3D, (handle context, cl_flags flags, void *image_format, size_t image_width, size_t image_height,
       size_t image_depth, size_t image_row_pitch, size_t image_slc_pitch, void *host_ptr, cl_int *error), (context,
       flags, image_format, image_width, image_height, image_depth, image_row_pitch, image_slc_pitch, host_ptr,
       error))
HANDLE(clCreateImage, (handle context, cl_flags flags, const void *image_format, const void *image_desc, void
       *host_ptr, cl_int *error), (context, flags, image_format, image_desc, host_ptr, error))
STATUS(clRetainMemObject, (handle memobj), (memobj))
STATUS(clReleaseMemObject, (handle memobj), (memobj))
STATUS(clGetSupportedImageFormats, (handle context, cl_flags flags, cl_uint image_type, cl_uint num_entries, void
       *image_formats, cl_uint *num_image_formats), (context, flags, image_type, num_entries, image_formats,
       num_image_formats))
STATUS(clGetMemObjectInfo, (handle memobj, cl_uint what, size_t size, void *value, size_t *size_ret), (memobj, what,
       size, value, size_ret))
STATUS(clGetImageInfo, (handle image, cl_uint what, size_t size, void *value, size_t *size_ret), (image, what, size,
       value, size_ret))
STATUS(clSetMemObjectDestructorCallback, (handle memobj, callback pfn_notify, void *user_data), (memobj, pfn_notify,
       user_data))
HANDLE(clCreateSampler, (handle context, cl_uint normalize_coords, cl_uint addressing_mode, cl_uint filter_mode,
       cl_int *error), (context, normalize_coords, addressing_mode, filter_mode, error))
STATUS(clRetainSampler, (handle sampler), (sampler))
STATUS(clReleaseSampler, (handle sampler), (sampler))
STATUS(clGetSamplerInfo, (handle sampler, cl_uint what, size_t size, void *value, size_t *size_ret), (sampler, what,
       size, value, size_ret))
HANDLE(clCreateProgramWithSource, (handle context, cl_uint count, const char *const *strings, const size_t *lengths,
       cl_int *error), (context, count, strings, lengths, error))
HANDLE(clCreateProgramWithBinary, (handle context, cl_uint num_devices, const handle *device_list, const size_t
       *lengths, const unsigned char *const *binaries, cl_int *binary_status, cl_int *error), (context, num_devices,
       device_list, lengths, binaries, binary_status, error))
HANDLE(clCreateProgramWithBuiltInKernels, (handle context, cl_uint num_devices, const handle *device_list, const char
       *kernel_names, cl_int *error), (context, num_devices, device_list, kernel_names, error))
STATUS(clRetainProgram, (handle program), (program))
STATUS(clReleaseProgram, (handle program), (program))
STATUS(clBuildProgram, (handle program, cl_uint num_devices, const handle *device_list, const char *options, callback
       pfn_notify, void *user_data), (program, num_devices, device_list, options, pfn_notify, user_data))
STATUS(clUnloadCompiler, (void), ())
STATUS(clCompileProgram, (handle program, cl_uint num_devices, const handle *device_list, const char *options, cl_uint
       num_input_headers, const handle *input_headers, const char *const *header_include_names, callback pfn_notify,
       void *user_data), (program, num_devices, device_list, options, num_input_headers, input_headers,
       header_include_names, pfn_notify, user_data))
HANDLE(clLinkProgram, (handle context, cl_uint num_devices, const handle *device_list, const char *options, cl_uint
       num_input_programs, const handle *input_programs, callback pfn_notify, void *user_data, cl_int *error),
       (context, num_devices, device_list, options, num_input_programs, input_programs, pfn_notify, user_data, error))
STATUS(clGetProgramInfo, (handle program, cl_uint what, size_t size, void *value, size_t *size_ret), (program, what,
       size, value, size_ret))
STATUS(clGetProgramBuildInfo, (handle program, handle device, cl_uint what, size_t size, void *value, size_t
       *size_ret), (program, device, what, size, value, size_ret))
HANDLE(clCreateKernel, (handle program, const char *kernel_name, cl_int *error), (program, kernel_name, error))
STATUS(clCreateKernelsInProgram, (handle program, cl_uint num_kernels, handle *kernels, cl_uint *num_kernels_ret),
       (program, num_kernels, kernels, num_kernels_ret))
STATUS(clRetainKernel, (handle kernel), (kernel))
STATUS(clReleaseKernel, (handle kernel), (kernel))
STATUS(clSetKernelArg, (handle kernel, cl_uint arg_index, size_t arg_size, const void *arg_value), (kernel, arg_index,
       arg_size, arg_value))
STATUS(clGetKernelInfo, (handle kernel, cl_uint what, size_t size, void *value, size_t *size_ret), (kernel, what,
       size, value, size_ret))
STATUS(clGetKernelArgInfo, (handle kernel, cl_uint arg_indx, cl_uint what, size_t size, void *value, size_t
       *size_ret), (kernel, arg_indx, what, size, value, size_ret))
STATUS(clGetKernelWorkGroupInfo, (handle kernel, handle device, cl_uint what, size_t size, void *value, size_t
       *size_ret), (kernel, device, what, size, value, size_ret))
STATUS(clWaitForEvents, (cl_uint num_events, const handle *event_list), (num_events, event_list))
STATUS(clGetEventInfo, (handle event, cl_uint what, size_t size, void *value, size_t *size_ret), (event, what, size,
       value, size_ret))
HANDLE(clCreateUserEvent, (handle context, cl_int *error), (context, error))
STATUS(clRetainEvent, (handle event), (event))
STATUS(clReleaseEvent, (handle event), (event))
STATUS(clSetUserEventStatus, (handle event, cl_int execution_status), (event, execution_status))
STATUS(clSetEventCallback, (handle event, cl_int command_exec_callback_type, callback pfn_notify, void *user_data),
       (event, command_exec_callback_type, pfn_notify, user_data))
STATUS(clGetEventProfilingInfo, (handle event, cl_uint what, size_t size, void *value, size_t *size_ret), (event,
       what, size, value, size_ret))
STATUS(clFlush, (handle queue), (queue))
STATUS(clFinish, (handle queue), (queue))
STATUS(clEnqueueReadBuffer, (handle queue, handle buffer, cl_uint blocking_read, size_t offset, size_t cb, void *ptr,
       cl_uint waits, const handle *wait_list, handle *event), (queue, buffer, blocking_read, offset, cb, ptr, waits,
       wait_list, event))
STATUS(clEnqueueReadBufferRect, (handle queue, handle buffer, cl_uint blocking_read, const size_t *buffer_origin,
       const size_t *host_origin, const size_t *region, size_t buffer_row_pitch, size_t buffer_slc_pitch, size_t
       host_row_pitch, size_t host_slc_pitch, void *ptr, cl_uint waits, const handle *wait_list, handle *event),
       (queue, buffer, blocking_read, buffer_origin, host_origin, region, buffer_row_pitch, buffer_slc_pitch,
       host_row_pitch, host_slc_pitch, ptr, waits, wait_list, event))
STATUS(clEnqueueWriteBuffer, (handle queue, handle buffer, cl_uint blocking_write, size_t offset, size_t cb, const
       void *ptr, cl_uint waits, const handle *wait_list, handle *event), (queue, buffer, blocking_write, offset, cb,
       ptr, waits, wait_list, event))
STATUS(clEnqueueWriteBufferRect, (handle queue, handle buffer, cl_uint blocking_write, const size_t *buffer_origin,
       const size_t *host_origin, const size_t *region, size_t buffer_row_pitch, size_t buffer_slc_pitch, size_t
       host_row_pitch, size_t host_slc_pitch, const void *ptr, cl_uint waits, const handle *wait_list, handle *event),
       (queue, buffer, blocking_write, buffer_origin, host_origin, region, buffer_row_pitch, buffer_slc_pitch,
       host_row_pitch, host_slc_pitch, ptr, waits, wait_list, event))
STATUS(clEnqueueFillBuffer, (handle queue, handle buffer, const void *pattern, size_t pattern_size, size_t offset,
       size_t size, cl_uint waits, const handle *wait_list, handle *event), (queue, buffer, pattern, pattern_size,
       offset, size, waits, wait_list, event))
STATUS(clEnqueueCopyBuffer, (handle queue, handle src_buffer, handle dst_buffer, size_t src_offset, size_t dst_offset,
       size_t cb, cl_uint waits, const handle *wait_list, handle *event), (queue, src_buffer, dst_buffer, src_offset,
       dst_offset, cb, waits, wait_list, event))
STATUS(clEnqueueCopyBufferRect, (handle queue, handle src_buffer, handle dst_buffer, const size_t *src_origin, const
       size_t *dst_origin, const size_t *region, size_t src_row_pitch, size_t src_slc_pitch, size_t dst_row_pitch,
       size_t dst_slc_pitch, cl_uint waits, const handle *wait_list, handle *event), (queue, src_buffer, dst_buffer,
       src_origin, dst_origin, region, src_row_pitch, src_slc_pitch, dst_row_pitch, dst_slc_pitch, waits, wait_list,
       event))
STATUS(clEnqueueReadImage, (handle queue, handle image, cl_uint blocking_read, const size_t *origin, const size_t
       *region, size_t row_pitch, size_t slc_pitch, void *ptr, cl_uint waits, const handle *wait_list, handle *event),
       (queue, image, blocking_read, origin, region, row_pitch, slc_pitch, ptr, waits, wait_list, event))
STATUS(clEnqueueWriteImage, (handle queue, handle image, cl_uint blocking_write, const size_t *origin, const size_t
       *region, size_t input_row_pitch, size_t input_slc_pitch, const void *ptr, cl_uint waits, const handle
       *wait_list, handle *event), (queue, image, blocking_write, origin, region, input_row_pitch, input_slc_pitch,
       ptr, waits, wait_list, event))
STATUS(clEnqueueFillImage, (handle queue, handle image, const void *fill_color, const size_t *origin, const size_t
       *region, cl_uint waits, const handle *wait_list, handle *event), (queue, image, fill_color, origin, region,
       waits, wait_list, event))
STATUS(clEnqueueCopyImage, (handle queue, handle src_image, handle dst_image, const size_t *src_origin, const size_t
       *dst_origin, const size_t *region, cl_uint waits, const handle *wait_list, handle *event), (queue, src_image,
       dst_image, src_origin, dst_origin, region, waits, wait_list, event))
STATUS(clEnqueueCopyImageToBuffer, (handle queue, handle src_image, handle dst_buffer, const size_t *src_origin, const
       size_t *region, size_t dst_offset, cl_uint waits, const handle *wait_list, handle *event), (queue, src_image,
       dst_buffer, src_origin, region, dst_offset, waits, wait_list, event))
STATUS(clEnqueueCopyBufferToImage, (handle queue, handle src_buffer, handle dst_image, size_t src_offset, const size_t
       *dst_origin, const size_t *region, cl_uint waits, const handle *wait_list, handle *event), (queue, src_buffer,
       dst_image, src_offset, dst_origin, region, waits, wait_list, event))
HANDLE(clEnqueueMapBuffer, (handle queue, handle buffer, cl_uint blocking_map, cl_flags map_flags, size_t offset,
       size_t size, cl_uint waits, const handle *wait_list, handle *event, cl_int *error), (queue, buffer,
       blocking_map, map_flags, offset, size, waits, wait_list, event, error))
HANDLE(clEnqueueMapImage, (handle queue, handle image, cl_uint blocking_map, cl_flags map_flags, const size_t *origin,
       const size_t *region, size_t *image_row_pitch, size_t *image_slc_pitch, cl_uint waits, const handle *wait_list,
       handle *event, cl_int *error), (queue, image, blocking_map, map_flags, origin, region, image_row_pitch,
       image_slc_pitch, waits, wait_list, event, error))
STATUS(clEnqueueUnmapMemObject, (handle queue, handle memobj, void *mapped_ptr, cl_uint waits, const handle
       *wait_list, handle *event), (queue, memobj, mapped_ptr, waits, wait_list, event))
STATUS(clEnqueueMigrateMemObjects, (handle queue, cl_uint num_mem_objects, const handle *mem_objects, cl_uint flags,
       cl_uint waits, const handle *wait_list, handle *event), (queue, num_mem_objects, mem_objects, flags, waits,
       wait_list, event))
STATUS(clEnqueueNDRangeKernel, (handle queue, handle kernel, cl_uint work_dim, const size_t *global_work_offset, const
       size_t *global_work_dims, const size_t *local_work_dims, cl_uint waits, const handle *wait_list, handle
       *event), (queue, kernel, work_dim, global_work_offset, global_work_dims, local_work_dims, waits, wait_list,
       event))
STATUS(clEnqueueTask, (handle queue, handle kernel, cl_uint waits, const handle *wait_list, handle *event), (queue,
       kernel, waits, wait_list, event))
STATUS(clEnqueueNativeKernel, (handle queue, callback user_func, void *args, size_t cb_args, cl_uint num_mem_objects,
       const handle *mem_list, const void *const *args_mem_loc, cl_uint waits, const handle *wait_list, handle
       *event), (queue, user_func, args, cb_args, num_mem_objects, mem_list, args_mem_loc, waits, wait_list, event))
STATUS(clEnqueueMarker, (handle queue, handle *event), (queue, event))
STATUS(clEnqueueMarkerWithWaitList, (handle queue, cl_uint waits, const handle *wait_list, handle *event), (queue,
       waits, wait_list, event))
STATUS(clEnqueueWaitForEvents, (handle queue, cl_uint num_events, handle *event_list), (queue, num_events,
       event_list))
STATUS(clEnqueueBarrierWithWaitList, (handle queue, cl_uint waits, const handle *wait_list, handle *event), (queue,
       waits, wait_list, event))
STATUS(clEnqueueBarrier, (handle queue), (queue))
ADDRESS(clGetExtensionFunctionAddress, (char *func_name), (func_name))
ADDRESS(clGetExtensionFunctionAddressForPlatform, (handle platform, const char *func_name), (platform, func_name))
HANDLE(clCreateFromGLBuffer, (handle context, cl_flags flags, cl_uint bufobj, cl_int *error), (context, flags, bufobj,
       error))
HANDLE(clCreateFromGLTexture, (handle context, cl_flags flags, cl_uint texture_target, cl_int miplevel, cl_uint
       texture, cl_int *error), (context, flags, texture_target, miplevel, texture, error))
STATUS(clGetGLObjectInfo, (handle memobj, cl_uint *gl_object_type, cl_uint *gl_object_name), (memobj, gl_object_type,
       gl_object_name))
STATUS(clGetGLTextureInfo, (handle memobj, cl_uint what, size_t size, void *value, size_t *size_ret), (memobj, what,
       size, value, size_ret))
HANDLE(clCreateFromGLRenderbuffer, (handle context, cl_flags flags, cl_uint renderbuffer, cl_int *error), (context,
       flags, renderbuffer, error))
STATUS(clEnqueueAcquireGLObjects, (handle queue, cl_uint num_objects, const handle *mem_objects, cl_uint waits, const
       handle *wait_list, handle *event), (queue, num_objects, mem_objects, waits, wait_list, event))
STATUS(clEnqueueReleaseGLObjects, (handle queue, cl_uint num_objects, const handle *mem_objects, cl_uint waits, const
       handle *wait_list, handle *event), (queue, num_objects, mem_objects, waits, wait_list, event))
STATUS(clGetGLContextInfoKHR, (const intptr_t *properties, cl_uint what, size_t size, void *value, size_t *size_ret),
       (properties, what, size, value, size_ret))
HANDLE(clCreateFromGLTexture2D, (handle context, cl_flags flags, cl_uint texture_target, cl_int miplevel, cl_uint
       texture, cl_int *error), (context, flags, texture_target, miplevel, texture, error))
HANDLE(clCreateFromGLTexture3D, (handle context, cl_flags flags, cl_uint texture_target, cl_int miplevel, cl_uint
       texture, cl_int *error), (context, flags, texture_target, miplevel, texture, error))
