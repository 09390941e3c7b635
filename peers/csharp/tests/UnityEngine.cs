// Stand-ins for the few classes of UnityEngine that HapticMaster uses, to compile and run it without Unity.
// They are for tests only, and no part of the package.
using System;
using System.Reflection;

namespace UnityEngine.Events
{
    public class UnityEvent<T>
    {
        private event Action<T> Called;

        public void AddListener(Action<T> listener)
        {
            Called += listener;
        }

        public void Invoke(T value)
        {
            if (Called != null)
                Called(value);
        }
    }
}

namespace UnityEngine
{
    public sealed class AddComponentMenu : Attribute
    {
        public AddComponentMenu(string name)
        {
        }
    }

    public sealed class HeaderAttribute : Attribute
    {
        public HeaderAttribute(string name)
        {
        }
    }

    public sealed class RangeAttribute : Attribute
    {
        public RangeAttribute(float least, float most)
        {
        }
    }

    public struct Vector3
    {
        public float x, y, z;

        public Vector3(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }

        public static Vector3 zero
        {
            get { return new Vector3(); }
        }

        public float magnitude
        {
            get { return (float)Math.Sqrt(x * x + y * y + z * z); }
        }

        public static Vector3 ClampMagnitude(Vector3 vector, float most)
        {
            float share = vector.magnitude > most ? most / vector.magnitude : 1.0f;
            return new Vector3(vector.x * share, vector.y * share, vector.z * share);
        }
    }

    // Rotated by quarter turns about the y axis, so that axes that are mixed up are seen.
    public class Transform
    {
        public Vector3 position;
        public float scale = 1.0f;
        public bool turned;

        public Vector3 InverseTransformPoint(Vector3 point)
        {
            float x = (point.x - position.x) / scale, y = (point.y - position.y) / scale;
            float z = (point.z - position.z) / scale;
            return turned ? new Vector3(-z, y, x) : new Vector3(x, y, z);
        }

        public Vector3 TransformDirection(Vector3 direction)
        {
            return turned ? new Vector3(direction.z, direction.y, -direction.x) : direction;
        }
    }

    public class Rigidbody
    {
        public Vector3 force;

        public void AddForce(Vector3 newtons)
        {
            force = newtons;
        }
    }

    public static class Time
    {
        public static float fixedDeltaTime = 0.02f;
    }

    public static class Debug
    {
        public static void Log(string text, object context)
        {
            Console.WriteLine("log " + text);
        }

        public static void LogError(string text, object context)
        {
            Console.WriteLine("error " + text);
        }
    }

    public class MonoBehaviour
    {
        private bool _enabled;

        public readonly Transform transform = new Transform();

        public bool enabled
        {
            get
            {
                return _enabled;
            }

            set
            {
                if (value == _enabled)
                    return;
                _enabled = value;
                Send(value ? "OnEnable" : "OnDisable");
            }
        }

        // Unity calls such methods by their names.
        public void Send(string message)
        {
            MethodInfo method = GetType().GetMethod(message, BindingFlags.Instance | BindingFlags.NonPublic);
            method.Invoke(this, null);
        }
    }
}
